"""What a photograph says of itself."""

from __future__ import annotations

from dataclasses import replace

import torch

from registry.testing import tiny_scene


def test_solid_is_what_no_background_shines_through() -> None:
    view = tiny_scene().train[0]
    assert view.solid is None
    levels = torch.tensor([[0, 1, 128], [252, 253, 255]])
    solid = replace(view, alpha=levels / 255).solid
    assert solid is not None
    assert solid.tolist() == [[False, False, False], [False, True, True]]
