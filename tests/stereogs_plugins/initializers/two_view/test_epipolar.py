"""Depth from a correspondence and two known cameras."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Camera
from stereogs_plugins.initializers.two_view import intersect

FIRST = Camera.look_at((0, 0, 0), (0.2, 0.1, 5), 60, 80, 60)
SECOND = Camera.look_at((1.0, -0.3, 0.2), (0, 0, 6), 75, 100, 70)


def some_points() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Pixels of points in both cameras, and their depth in the first."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(50, 3, generator=generator, dtype=torch.float64) * 2 - 1
    points[:, 2] += 5
    u, v, z = FIRST.project(points)
    other_u, other_v, _ = SECOND.project(points)
    return torch.stack([u, v], dim=1), torch.stack([other_u, other_v], dim=1), z


def test_an_exact_correspondence_gives_the_depth() -> None:
    here, there, z = some_points()
    found = intersect(FIRST, SECOND, here, there)
    torch.testing.assert_close(found.depth, z)
    assert (found.distance < 1e-9).all()


def test_distance_is_that_to_the_epipolar_line() -> None:
    here, there, z = some_points()
    ends = []
    for depth in (0.9 * z, 1.1 * z):  # two places on the ray, as the other camera shows them
        u, v, _ = SECOND.project(FIRST.unproject(here[:, 0], here[:, 1], depth))
        ends.append(torch.stack([u, v], dim=1))
    along = (ends[1] - ends[0]) / (ends[1] - ends[0]).norm(dim=1, keepdim=True)
    across = torch.stack([-along[:, 1], along[:, 0]], dim=1)
    found = intersect(FIRST, SECOND, here, there + 0.7 * across)
    torch.testing.assert_close(found.distance, torch.full_like(z, 0.7))
    torch.testing.assert_close(found.depth, z)  # the nearest point of the line is where it was


def test_sensitivity_is_the_change_of_depth_along_the_line() -> None:
    here, there, z = some_points()
    step = 1e-4 * z
    u, v, _ = SECOND.project(FIRST.unproject(here[:, 0], here[:, 1], z + step))
    pixels = (torch.stack([u, v], dim=1) - there).norm(dim=1)
    found = intersect(FIRST, SECOND, here, there)
    torch.testing.assert_close(found.sensitivity, step / pixels, rtol=0.01, atol=0)


def test_diverging_rays_have_no_depth() -> None:
    first = Camera.centered(torch.eye(4), 50, 60, 40)
    second = first.shifted_right(1.0)
    here = torch.tensor([[30.0, 20.0], [30.0, 20.0], [30.0, 20.0]])
    there = torch.tensor([[20.0, 20.0], [30.0, 20.0], [40.0, 20.0]])  # disparities 10, 0, -10
    depth = intersect(first, second, here, there).depth
    assert float(depth[0]) == pytest.approx(5.0)
    assert depth[1:].isfinite().tolist() == [False, False]
