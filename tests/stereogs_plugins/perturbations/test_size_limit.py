from __future__ import annotations

import torch

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.testing import step_of, tiny_scene
from stereogs_plugins.perturbations.size_limit import SizeLimit
from tests.stereogs_plugins.building import build

CENTERS = torch.tensor([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]])
"""Of the tiny scene's training cameras."""


def limited(means: torch.Tensor, scales: torch.Tensor, angle: float) -> torch.Tensor:
    """The scales after one call."""
    count = len(means)
    gaussians = Gaussians(
        means=means,
        log_scales=scales.log(),
        quaternions=torch.tensor([1.0, 0, 0, 0]).expand(count, 4).contiguous(),
        opacity_logits=torch.zeros(count),
        sh=torch.zeros(count, 1, 3),
    )
    step = step_of(GaussianModel(gaussians, open_device()), tiny_scene())
    offsets = build(SizeLimit, angle=angle).offsets(step)
    assert list(offsets) == ["log_scales"]
    return (gaussians.log_scales + offsets["log_scales"]).exp()


def test_each_axis_stays_below_its_share_of_the_nearest_cameras_distance() -> None:
    means = torch.tensor([[0.2, 0.0, 2.0], [-0.2, 3.0, 4.0], [1.2, 0.0, 0.0]])
    scales = torch.tensor([[0.1, 0.3, 0.2], [9.0, 0.01, 0.51], [0.4, 0.05, 0.11]])
    expected = torch.tensor([[0.1, 0.2, 0.2], [0.5, 0.01, 0.5], [0.1, 0.05, 0.1]])
    torch.testing.assert_close(limited(means, scales, 0.1), expected)


def test_what_is_small_stays_bit_by_bit() -> None:
    means = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)) + torch.tensor([0, 0, 5])
    scales = torch.full((50, 3), 0.013)
    assert torch.equal(limited(means, scales, 0.5), scales.log().exp())


def test_in_a_camera_itself_a_gaussian_becomes_a_point() -> None:
    scales = limited(CENTERS, torch.ones(2, 3), 0.1)
    assert torch.isfinite(scales.log()).all()
    assert (scales < 1e-5).all()
