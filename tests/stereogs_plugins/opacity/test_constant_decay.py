from __future__ import annotations

import torch

from stereogs_plugins.opacity.constant_decay import (
    ConstantDecay,
    stereogs_register_opacity_policies,
)
from tests.stereogs_plugins.building import build, offered, some_gaussians, step_with


def test_is_offered_as_constant_decay() -> None:
    assert offered(stereogs_register_opacity_policies) == {"constant_decay": ConstantDecay}


def test_multiplies_and_keeps_the_moments() -> None:
    step = step_with(some_gaussians([0.05, 0.05], [0.8, 0.1]))
    update = build(ConstantDecay).update(step)
    torch.testing.assert_close(update.opacities, torch.tensor([0.796, 0.0995]))
    assert not update.reset_moments
    half = build(ConstantDecay, factor=0.5).update(step)
    torch.testing.assert_close(half.opacities, torch.tensor([0.4, 0.05]))
