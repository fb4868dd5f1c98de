from __future__ import annotations

import math

import pytest
import torch

from registry import PointCloud
from registry.training.initial_model import initial_gaussians, mean_squared_distances
from tests.host import TrainingSettings

SETTINGS = TrainingSettings(sh_degree=2)


def cloud(count: int) -> PointCloud:
    generator = torch.Generator().manual_seed(count)
    return PointCloud(
        torch.randn(count, 3, generator=generator), torch.rand(count, 3, generator=generator)
    )


def test_size_is_the_distance_to_three_neighbours() -> None:
    positions = cloud(40).positions.double()
    squared = (positions[:, None] - positions[None]).square().sum(-1)
    expected = squared.sort(dim=1).values[:, 1:4].mean(dim=1)
    torch.testing.assert_close(mean_squared_distances(positions), expected)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_few_points(count: int) -> None:
    gaussians = initial_gaussians(cloud(count), SETTINGS).check_finite()
    assert len(gaussians) == count
    assert gaussians.sh.shape == (count, 9, 3)
    if count == 1:
        assert float(gaussians.log_scales[0, 0]) == pytest.approx(math.log(math.sqrt(1e-7)))


def test_duplicates_get_a_size() -> None:
    positions = torch.ones(6, 3)
    gaussians = initial_gaussians(PointCloud(positions, torch.rand(6, 3)), SETTINGS)
    gaussians.check_finite()
    assert (gaussians.log_scales.exp() > 1e-4).all()


def test_scales_and_opacities_of_the_points_are_used() -> None:
    points = PointCloud(
        torch.zeros(1, 3),
        torch.tensor([[0.2, 0.5, 0.9]]),
        scales=torch.tensor([0.25]),
        opacities=torch.tensor([0.7]),
    )
    gaussians = initial_gaussians(points, SETTINGS)
    torch.testing.assert_close(gaussians.log_scales.exp(), torch.full((1, 3), 0.25))
    torch.testing.assert_close(gaussians.opacity_logits.sigmoid(), torch.tensor([0.7]))
    torch.testing.assert_close(
        gaussians.sh[:, 0] * 0.28209479177387814 + 0.5, torch.tensor([[0.2, 0.5, 0.9]])
    )
    default = initial_gaussians(cloud(5), SETTINGS)
    torch.testing.assert_close(default.opacity_logits.sigmoid(), torch.full((5,), 0.1))


def test_initial_scale_multiplies_the_size() -> None:
    settings = TrainingSettings(initial_scale=0.1)
    whole, tenth = (initial_gaussians(cloud(9), s).log_scales.exp() for s in (SETTINGS, settings))
    torch.testing.assert_close(tenth, 0.1 * whole)
