"""Few other views are asked about each view."""

from __future__ import annotations

from stereogs_plugins.initializers.consistency_dense.witnesses import MOST_WITNESSES, witnesses
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

BOUNDS = (2.0, 6.0)


def test_of_few_views_all_are_asked() -> None:
    cameras = [camera_at(0.2 * index) for index in range(MOST_WITNESSES + 1)]
    assert witnesses(cameras, 2, BOUNDS) == [0, 1, 3, 4, 5, 6, 7, 8]


def test_of_many_views_so_many_that_see_the_same_are_asked() -> None:
    cameras = [camera_at(0.2 * index) for index in range(30)]
    asked = witnesses(cameras, 0, BOUNDS)
    assert len(asked) == MOST_WITNESSES
    assert max(asked) < 12
