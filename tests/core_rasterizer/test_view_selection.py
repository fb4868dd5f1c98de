"""Selection of source views."""

from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import Camera
from core_rasterizer.matching import source_views
from core_rasterizer.matching.view_selection import matching_scores

BOUNDS = (3.0, 5.0)


def around(degrees: float, *, distance: float = 4.0, outwards: bool = False) -> Camera:
    """A camera that looks at the origin, or away from it, from an angle about the vertical axis."""
    angle = math.radians(degrees)
    eye = (distance * math.sin(angle), 0.0, -distance * math.cos(angle))
    target = tuple(2 * place for place in eye) if outwards else (0.0, 0.0, 0.0)
    return Camera.look_at(eye, target, 60, 48, 36)


def test_few_views_are_all_taken_the_nearest_first() -> None:
    cameras = [around(angle) for angle in (0, 170, 20, -8)]
    assert source_views(cameras, 3, BOUNDS)[0] == [3, 2, 1]
    assert source_views(cameras, 6, BOUNDS)[0] == [3, 2, 1]


def test_of_many_views_those_at_a_good_angle_are_taken() -> None:
    """Not the nearest, which sees no parallax, nor those from behind."""
    cameras = [around(angle) for angle in (0, 0.3, 180, 90, 6, -12, -150)]
    assert source_views(cameras, 2, BOUNDS)[0] == [4, 5]
    assert source_views(cameras, 1, BOUNDS)[0] == [4]


def test_a_view_that_sees_nothing_of_the_same_is_not_tried() -> None:
    away = [around(angle, outwards=True) for angle in (5, -10, 8)]
    cameras = [around(0), *away, around(15)]
    assert source_views(cameras, 3, BOUNDS)[0] == [4]


def test_without_a_view_that_sees_the_same_the_nearest_are_taken() -> None:
    cameras = [around(0), *(around(angle, outwards=True) for angle in (-10, 5, 20))]
    assert not matching_scores(cameras[0], cameras[1:], BOUNDS).any()
    assert source_views(cameras, 2, BOUNDS)[0] == [2, 1]


def test_views_in_the_same_place_are_left_out() -> None:
    cameras = [around(0)] * 3
    assert source_views(cameras, 2, BOUNDS)[1] == []
    assert source_views([*cameras, around(10)], 2, BOUNDS)[1] == [3]


def test_of_very_many_views_those_at_the_best_angle_are_taken() -> None:
    """The nearest ones of a dense capture have too small an angle."""
    cameras = [around(angle / 4) for angle in range(-100, 101)]
    assert all(16 <= abs(k - 100) <= 32 for k in source_views(cameras, 8, BOUNDS)[100])


@pytest.mark.parametrize("degrees", [3.0, 5.0, 25.0])
def test_the_score_is_the_weight_of_the_angle(degrees: float) -> None:
    """A camera so far away that it sees all of the space under one angle."""
    far = 1e6
    here, there = around(0, distance=far), around(degrees, distance=far)
    # Long lenses: both images show one unit about the origin.
    cameras = [
        Camera(here.world_to_camera, 20 * far, 20 * far, 24, 18, 48, 36),
        Camera(there.world_to_camera, far, far, 24, 18, 48, 36),
    ]
    spread = 1.0 if degrees < 5 else 10.0
    expected = math.exp(-((degrees - 5) ** 2) / (2 * spread**2))
    scores = matching_scores(cameras[0], cameras[1:], (far - 1, far + 1))
    torch.testing.assert_close(
        scores, torch.tensor([expected], dtype=torch.float64), atol=1e-4, rtol=0
    )
