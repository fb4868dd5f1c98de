from __future__ import annotations

import pytest
import torch

from stereogs_plugins.modifiers.opacity_noise import OpacityNoise
from tests.stereogs_plugins.building import build, some_gaussians, step_with

COUNT = 20_000


def test_is_clamped_normal_noise_about_one() -> None:
    step = step_with(some_gaussians([0.01] * COUNT, [0.1] * COUNT))
    scale = build(OpacityNoise).opacity_scale(step)
    assert float(scale.mean()) == pytest.approx(1, abs=0.02)
    assert float(scale.min()) == pytest.approx(0.2)
    assert float(scale.max()) == pytest.approx(1.8)
    # A normal variable is beyond one standard deviation in 31.7 % of all cases.
    beyond = (scale < 0.2001) | (scale > 1.7999)
    assert float(beyond.float().mean()) == pytest.approx(0.317, abs=0.015)


def test_no_opacity_rises_above_one_and_without_sigma_none_changes() -> None:
    step = step_with(some_gaussians([0.01] * 200, [0.9] * 200))
    opacities = step.model.opacities()
    noisy = build(OpacityNoise).opacity_scale(step) * opacities
    assert float(noisy.max()) == pytest.approx(1)
    assert (build(OpacityNoise, sigma=0.0).opacity_scale(step) == 1).all()
    assert not torch.equal(noisy, opacities)
