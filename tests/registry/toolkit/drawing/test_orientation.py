from __future__ import annotations

import numpy as np
import pytest

from core_rasterizer import Camera
from registry.toolkit.drawing import upright_rotation, upwards


def camera(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    return Camera.look_at(eye, target, 30, 32, 24, up=(0, 0, 1))


def test_up_is_the_mean_over_a_ring_of_cameras() -> None:
    """Each camera looks down a little, which tilts its own up direction outwards; the mean is not tilted."""
    ring = [(3, 0, 1), (0, 3, 1), (-3, 0, 1), (0, -3, 1)]
    cameras = [camera(eye, (0, 0, 0)) for eye in ring]
    np.testing.assert_allclose(upwards(cameras), [0, 0, 1], atol=1e-12)


def test_if_directions_cancel_out_the_first_camera_decides() -> None:
    above = Camera.look_at((0, -3, 0), (0, 0, 0), 30, 32, 24, up=(0, 0, 1))
    upside_down = Camera.look_at((0, -3, 0), (0, 0, 0), 30, 32, 24, up=(0, 0, -1))
    np.testing.assert_allclose(upwards([above, upside_down]), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("eye", [(0.0, -4.0, 1.0), (5.0, 0.0, 3.0)])
def test_the_first_camera_sees_upright_along_minus_z(eye: tuple[float, float, float]) -> None:
    first = camera(eye, (0, 0, 0))
    rotation = upright_rotation([first, camera((-eye[0], -eye[1], eye[2]), (0, 0, 0))])
    np.testing.assert_allclose(rotation.apply([0, 0, 1]), [0, 1, 0], atol=1e-12)
    forward = rotation.apply(first.world_to_camera[2, :3].numpy())
    assert forward[2] < -0.8
    assert abs(forward[0]) < 1e-12
    assert np.linalg.det(rotation.as_matrix()) == pytest.approx(1)


def test_a_camera_may_look_straight_down() -> None:
    down = Camera.look_at((0, 0, 5), (0, 0, 0), 30, 32, 24, up=(0, 1, 0))
    beside = Camera.look_at((0, -5, 0), (0, 0, 0), 30, 32, 24, up=(0, 0, 1))
    rotation = upright_rotation([down, beside])
    assert np.isfinite(rotation.as_matrix()).all()
