from __future__ import annotations

import numpy as np
import pytest

from stereogs_plugins.initializers.consistency_dense.visibility import (
    MAX_SOURCES,
    in_free_space,
    on_surface,
    onto_known_depth,
    source_indices,
    spread,
    visible,
)
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

BOUNDS = (2.0, 6.0)
CAMERA = camera_at(0.0)
WALL = np.full((40, 60), 4.0, dtype=np.float32)
POINTS = np.array(
    [
        [0.0, 0.0, 2.0],  # before the wall
        [0.0, 0.0, 3.99],  # on it
        [0.0, 0.0, 5.0],  # behind it
        [9.0, 0.0, 4.0],  # beside the image
        [0.0, 0.0, -2.0],  # behind the camera
    ]
)


def test_points_against_a_wall() -> None:
    assert in_free_space(POINTS, [(CAMERA, WALL)]).tolist() == [True, False, False, False, False]
    assert on_surface(POINTS, [(CAMERA, WALL)]).tolist() == [False, True, False, False, False]
    assert onto_known_depth(POINTS, [(CAMERA, WALL)]).tolist() == [True, True, True, False, False]
    assert visible(POINTS, [(CAMERA, WALL)]).tolist() == [True, True, False, False, False]


def test_unknown_depth_excludes_no_point() -> None:
    unknown = np.zeros_like(WALL)
    for question in (in_free_space, on_surface, onto_known_depth):
        assert not question(POINTS, [(CAMERA, unknown)]).any()
    assert visible(POINTS, [(CAMERA, unknown)]).tolist() == [True, True, True, False, False]


def test_one_view_of_several_is_enough() -> None:
    unknown = np.zeros_like(WALL)
    assert in_free_space(POINTS, [(CAMERA, unknown), (CAMERA, WALL)])[0]
    assert not in_free_space(POINTS, []).any()


@pytest.mark.parametrize(("count", "most"), [(3, 48), (48, 48), (49, 48), (300, 7), (87, 32)])
def test_a_choice_of_views_is_even(count: int, most: int) -> None:
    chosen = np.array(spread(range(count), most))
    assert len(chosen) == min(count, most)
    gaps = np.diff(chosen, prepend=0, append=count)[1:]
    assert chosen[0] == 0
    assert 1 <= gaps.min() <= gaps.max() <= gaps.min() + 1


def test_without_a_limit_all_views_are_chosen() -> None:
    assert spread(range(300), None) == tuple(range(300))
    assert len(spread(range(300))) == 48


def test_few_views_are_all_source_views() -> None:
    cameras = tuple(camera_at(0.2 * index) for index in range(MAX_SOURCES + 1))
    assert source_indices(cameras, BOUNDS)[2] == (0, 1, 3, 4, 5, 6, 7, 8)


def test_many_views_give_the_nearest_source_views() -> None:
    cameras = tuple(camera_at(0.2 * index) for index in range(30))
    asked = source_indices(cameras, BOUNDS)[0]
    assert len(asked) == MAX_SOURCES
    assert max(asked) < 12
