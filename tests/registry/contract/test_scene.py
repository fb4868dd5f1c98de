"""Properties of views."""

from __future__ import annotations

from dataclasses import replace

import torch

from registry.testing import tiny_scene


def test_solid_pixels_are_those_without_background() -> None:
    view = tiny_scene().train[0]
    assert view.solid is None
    levels = torch.tensor([[0, 1, 128], [252, 253, 255]])
    solid = replace(view, alpha=levels / 255).solid
    assert solid is not None
    assert solid.tolist() == [[False, False, False], [False, True, True]]
