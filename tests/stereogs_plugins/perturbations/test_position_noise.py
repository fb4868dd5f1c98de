from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.testing import step_of, tiny_scene
from stereogs_plugins.perturbations.position_noise import PositionNoise, rotations
from tests.stereogs_plugins.building import build, some_gaussians, step_with

COUNT = 20_000


def test_quaternions_of_any_length_turn_as_scipy_says() -> None:
    from scipy.spatial.transform import Rotation

    quaternions = torch.randn(20, 4, generator=torch.Generator().manual_seed(0)).double()
    expected = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]].numpy()).as_matrix()
    torch.testing.assert_close(rotations(quaternions), torch.from_numpy(expected))


def test_noise_has_the_shape_of_the_squared_covariance() -> None:
    """Sigma times white noise has the covariance Sigma^2; scales 0.1, 0.2, 0.4, turned by 90 degrees."""
    quarter = torch.tensor([math.sqrt(0.5), 0, 0, math.sqrt(0.5)])  # about z: x becomes y
    gaussians = Gaussians(
        means=torch.zeros(COUNT, 3),
        log_scales=torch.tensor([0.1, 0.2, 0.4]).log().expand(COUNT, 3).contiguous(),
        quaternions=quarter.expand(COUNT, 4).contiguous(),
        opacity_logits=torch.full((COUNT,), 0.005).logit(),
        sh=torch.zeros(COUNT, 1, 3),
    )
    step = step_of(GaussianModel(gaussians, open_device()), tiny_scene())
    moved = build(PositionNoise, factor=1000.0).offsets(step)["means"]
    strength = step.learning_rates["means"] * 1000 * 0.5  # at the threshold itself
    expected = torch.tensor([0.2**2, 0.1**2, 0.4**2]) * strength
    torch.testing.assert_close(moved.std(0), expected, rtol=0.03, atol=0)
    assert torch.corrcoef(moved.T).fill_diagonal_(0).abs().max() < 0.05


def test_the_published_numbers_leave_opaque_ones_where_they_are() -> None:
    step = step_with(some_gaussians([0.1] * 3, [0.001, 0.105, 0.9]))
    noise = build(PositionNoise)
    size = torch.stack([noise.offsets(step)["means"].norm(dim=1) for _ in range(200)]).mean(0)
    # sigmoid(0.4) = 0.5987 and sigmoid(-10) = 4.54e-5
    assert float(size[1] / size[0]) == pytest.approx(4.54e-5 / 0.5987, rel=0.2)
    assert float(size[2]) < 1e-30


def test_one_seed_gives_the_same_noise() -> None:
    step = step_with(some_gaussians([0.1] * 3, [0.01] * 3))
    first, again, other = (build(PositionNoise, seed).offsets(step)["means"] for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
