from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from core_rasterizer import Camera
from registry.toolkit.drawing import (
    quarter_turns,
    smooth_path,
    turned,
    upright_rotation,
    upwards,
)


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


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_cameras_on_their_side_do_not_change_up(quarters: int) -> None:
    upright = [camera((x, -4, 1), (0, 0, 0)) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    others = [turned(one, quarters) for one in upright[1:3]]
    np.testing.assert_allclose(
        upwards([*others, *upright[:1], *upright[3:]]),
        upwards([*upright[:1], *upright[3:]]),
        atol=1e-12,
    )


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_turned_cameras_see_turned_images(quarters: int) -> None:
    lens = replace(camera((1, -4, 1), (0, 0, 0)), fx=30, fy=40, cx=14, cy=13)
    image = torch.zeros(24, 32)
    column, row, _ = lens.project(torch.tensor([[0.4, 0.1, 0.3]], dtype=torch.float64))
    image[int(row), int(column)] = 1
    other = turned(lens, quarters)
    column, row, _ = other.project(torch.tensor([[0.4, 0.1, 0.3]], dtype=torch.float64))
    assert torch.rot90(image, quarters)[int(row), int(column)] == 1
    assert (other.height, other.width) == torch.rot90(image, quarters).shape
    assert quarter_turns(other, np.array([0.0, 0.0, 1.0])) == -quarters % 4


def test_the_path_is_upright_and_not_stretched() -> None:
    upright = [camera((x, -4, 1), (0, 0, 0)) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    path = smooth_path([turned(upright[0], 1), *upright[1:]], 10)
    for one, same in zip(path, smooth_path(upright, 10), strict=True):
        torch.testing.assert_close(one.world_to_camera, same.world_to_camera)
    portrait = Camera.look_at((0, -4, 0), (0, 0, 0), 30, 24, 32, up=(0, 0, 1))
    last = smooth_path([*upright, portrait], 12)[10]
    assert (last.width, last.height, last.fx, last.cx) == (32, 24, last.fy, 16)


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
