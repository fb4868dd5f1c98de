from __future__ import annotations

import numpy as np
import pytest
import torch

from core_rasterizer import Camera
from registry.toolkit.drawing import CAMERA_LIMITS
from stereogs.verbs.view.reach import Reach

ANGLE = np.radians(CAMERA_LIMITS["angle"])


def around(*degrees: float) -> Reach:
    """Cameras at distance 4 around the origin, in a horizontal plane."""
    cameras = []
    for angle in np.radians(degrees):
        pose = np.eye(4)
        pose[:3, :3] = [
            [np.cos(angle), 0, np.sin(angle)],
            [0, 1, 0],
            [-np.sin(angle), 0, np.cos(angle)],
        ]
        pose[2, 3] = 4
        cameras.append(Camera.centered(torch.from_numpy(pose), 100, 100, 80))
    return Reach(cameras, [4.0] * len(cameras))


def eye_at(angle: float, distance: float = 4.0) -> np.ndarray:
    return distance * np.array([np.sin(angle), 0, -np.cos(angle)])


def test_a_camera_between_photographs_stays_where_it_is() -> None:
    eye, target = eye_at(np.radians(20)), np.zeros(3)
    found = around(0, 40).limited(eye, target)
    assert found[0] is eye
    assert found[1] is target


def test_far_photographs_do_not_count_as_neighbours() -> None:
    eye, _ = around(0, 80).limited(eye_at(np.radians(30)), np.zeros(3))
    np.testing.assert_allclose(eye, eye_at(ANGLE), atol=0.03)


@pytest.mark.parametrize("angle", [0.5, -0.5, 3.0])
def test_a_turn_ends_at_the_limit(angle: float) -> None:
    eye, target = around(0).limited(eye_at(angle), np.zeros(3))
    np.testing.assert_allclose(eye, eye_at(np.copysign(ANGLE, angle)), atol=0.03)
    np.testing.assert_allclose(target, 0)


@pytest.mark.parametrize("name", ["nearest", "farthest"])
def test_a_zoom_ends_at_the_limit(name: str) -> None:
    limit = CAMERA_LIMITS[name]
    eye, _ = around(0).limited(eye_at(0, 4 * limit**3), np.zeros(3))
    np.testing.assert_allclose(eye, eye_at(0, 4 * limit), rtol=1e-5, atol=1e-12)


def test_a_shift_ends_at_the_limit() -> None:
    aside = np.array([0, 3.0, 0])
    eye, target = around(0).limited(eye_at(0) + aside, aside)
    assert np.linalg.norm(target) <= 4 * CAMERA_LIMITS["shift"] * (1 + 1e-6)
    assert np.linalg.norm(eye - eye_at(0)) < 1.5
