from __future__ import annotations

import numpy as np

from stereogs_plugins.initializers.consistency_dense.other_views import (
    covered,
    hides,
    in_sight,
    overlooked,
)
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

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


def test_what_a_view_knows_about_points() -> None:
    assert hides(POINTS, [CAMERA], [WALL]).tolist() == [True, False, False, False, False]
    assert covered(POINTS, [CAMERA], [WALL]).tolist() == [False, True, False, False, False]
    assert overlooked(POINTS, [CAMERA], [WALL]).tolist() == [True, True, True, False, False]
    assert in_sight(POINTS, [CAMERA], [WALL]).tolist() == [True, True, False, False, False]


def test_unknown_depth_says_nothing() -> None:
    unknown = np.zeros_like(WALL)
    for question in (hides, covered, overlooked):
        assert not question(POINTS, [CAMERA], [unknown]).any()
    assert in_sight(POINTS, [CAMERA], [unknown]).tolist() == [True, True, True, False, False]


def test_one_view_of_several_is_enough() -> None:
    unknown = np.zeros_like(WALL)
    assert hides(POINTS, [CAMERA, CAMERA], [unknown, WALL])[0]
    assert not hides(POINTS, [], []).any()
