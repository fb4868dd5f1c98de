"""The camera: geometry and validation."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
import torch

from core_rasterizer import Camera, CameraError


def camera(**changes: Any) -> Camera:
    settings: dict[str, Any] = {
        "world_to_camera": np.eye(4),
        "fx": 50.0,
        "fy": 60.0,
        "cx": 20.0,
        "cy": 15.0,
        "width": 40,
        "height": 30,
    }
    return Camera(**(settings | changes))


def turned() -> torch.Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    c, s = math.cos(0.4), math.sin(0.4)
    pose[:3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)
    pose[:3, 3] = torch.tensor([0.5, -1.0, 2.0])
    return pose


def test_the_center_maps_to_the_origin_of_the_camera() -> None:
    view = camera(world_to_camera=turned())
    homogeneous = torch.cat([view.center, torch.ones(1, dtype=torch.float64)])
    assert torch.allclose((view.world_to_camera @ homogeneous)[:3], torch.zeros(3).double())
    assert torch.allclose(view.camera_to_world @ view.world_to_camera, torch.eye(4).double())


def test_project_follows_the_calibration() -> None:
    u, v, z = camera().project(torch.tensor([[0.2, -0.1, 2.0], [0.0, 0.0, -1.0]]))
    assert (float(u[0]), float(v[0]), float(z[0])) == pytest.approx((25.0, 12.0, 2.0))
    assert z[1] == -1, "behind the camera"
    view = camera(world_to_camera=turned())
    ahead = view.camera_to_world[:3] @ torch.tensor([0.0, 0.0, 3.0, 1.0]).double()
    u, v, z = view.project(ahead.expand(4, 5, 3))
    assert u.shape == v.shape == z.shape == (4, 5)
    assert torch.allclose(u, torch.tensor(view.cx).double())
    assert torch.allclose(v, torch.tensor(view.cy).double())
    assert torch.allclose(z, torch.tensor(3.0).double())


def test_contains_follows_the_pixel_grid_and_the_depth() -> None:
    view = camera()
    u = torch.tensor([0.0, 39.99, 40.0, -0.01, 20.0, 20.0, math.nan])
    v = torch.tensor([0.0, 29.99, 15.0, 15.0, 30.0, -0.01, 15.0])
    assert view.contains(u, v).tolist() == [True, True, *[False] * 5]
    with_border = [True, True, True, False, True, False, False]
    assert view.contains(u, v, border=True).tolist() == with_border
    z = torch.tensor([1.0, 0.0, -1.0, 1.0, math.nan, 1.0, 1.0])
    assert view.contains(u, v, z, border=True).tolist() == [True, *[False] * 6]


def test_contains_keeps_the_shape_of_projected_points() -> None:
    points = torch.tensor(
        [[[0.2, -0.1, 2.0], [0.0, 0.0, -1.0]], [[9.0, 0.0, 1.0], [0.0, 0.0, 1.0]]]
    )
    assert camera().contains(*camera().project(points)).tolist() == [[True, False], [False, True]]


def test_a_camera_is_immutable() -> None:
    with pytest.raises(FrozenInstanceError):
        camera().fx = 1.0  # type: ignore[misc]


def test_unproject_inverts_project() -> None:
    view = camera(world_to_camera=turned(), cx=17.5)
    u, v = view.pixel_centers()
    depth = torch.rand(30, 40, generator=torch.Generator().manual_seed(0)) + 0.5
    points = view.unproject(u, v, depth)
    assert points.shape == (30, 40, 3)
    assert points.dtype == torch.float64
    for found, expected in zip(view.project(points), (u, v, depth.double()), strict=True):
        assert torch.allclose(found, expected, rtol=0, atol=1e-12)


def test_unproject_broadcasts() -> None:
    points = camera().unproject(torch.tensor([20.0, 45.0]), torch.tensor(9.0), torch.tensor(2.0))
    assert torch.allclose(points, torch.tensor([[0.0, -0.2, 2.0], [1.0, -0.2, 2.0]]).double())


def test_pixel_centers_are_half_integers_in_rows_and_columns() -> None:
    u, v = camera(width=3, height=2).pixel_centers()
    assert u.tolist() == [[0.5, 1.5, 2.5]] * 2
    assert v.tolist() == [[0.5] * 3, [1.5] * 3]


def test_shifted_right_moves_along_the_x_axis() -> None:
    left = camera(world_to_camera=turned())
    right = left.shifted_right(0.3)
    offset = left.world_to_camera[:3, :3] @ (right.center - left.center)
    assert torch.allclose(offset, torch.tensor([0.3, 0.0, 0.0]).double())


def test_resizing_keeps_the_field_of_view() -> None:
    small = camera().resized(20, 15)
    assert (small.fx, small.fy, small.cx, small.cy) == (25.0, 30.0, 10.0, 7.5)
    assert (small.width, small.height) == (20, 15)


def test_the_pose_stays_in_autograd() -> None:
    """Through every method, and for several backward passes."""
    pose = turned().float().requires_grad_()
    left = camera(world_to_camera=pose)
    right = left.shifted_right(0.3).resized(20, 15)
    for _ in range(2):
        u, _, z = right.project(torch.tensor([[0.2, -0.1, 2.0]]))
        for values in (
            u + z,
            right.unproject(u.detach(), u.detach(), z.detach()),
            left.center,
            left.camera_to_world,
        ):
            pose.grad = None
            values.sum().backward()
            assert pose.grad is not None
            assert pose.grad[:3].any()
            assert not pose.grad[3].any()
    with torch.no_grad():
        assert not camera(world_to_camera=pose).world_to_camera.requires_grad


def test_a_camera_keeps_the_pose_that_it_was_given() -> None:
    pose = turned()
    view = camera(world_to_camera=pose)
    pose[0, 3] = 9.0
    assert view.world_to_camera[0, 3] == 0.5


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"fx": -3.0}, "camera.fx", "positive"),
        ({"fy": 0.0}, "camera.fy", "positive"),
        ({"cx": math.nan}, "camera.cx", "finite"),
        ({"width": 0}, "camera.width", "at least 1"),
        ({"height": 2.5}, "camera.height", "whole number"),
        ({"world_to_camera": np.full((4, 4), np.nan)}, "camera.world_to_camera", "finite"),
        ({"world_to_camera": np.eye(3)}, "camera.world_to_camera", "shape"),
        ({"world_to_camera": 2 * np.eye(4)}, "camera.world_to_camera", "rotation"),
        ({"world_to_camera": np.diag([1.0, 1, -1, 1])}, "camera.world_to_camera", "rotation"),
        ({"world_to_camera": np.diag([1.0, 1, 1, 2])}, "camera.world_to_camera", "last row"),
    ],
)
def test_invalid_cameras_raise(changes: dict[str, Any], field: str, message: str) -> None:
    with pytest.raises(CameraError, match=message) as error:
        camera(**changes)
    assert error.value.where == field


def test_look_at_centers_its_target() -> None:
    chosen = Camera.look_at((1.0, -2.0, 0.5), (0.2, 0.1, 4.0), 30.0, 40, 30)
    u, v, z = chosen.project(torch.tensor([0.2, 0.1, 4.0]))
    distance = math.dist((1.0, -2.0, 0.5), (0.2, 0.1, 4.0))
    assert (float(u), float(v), float(z)) == pytest.approx((20, 15, distance))
    assert chosen.center.tolist() == pytest.approx([1.0, -2.0, 0.5])
    _, above, _ = chosen.project(torch.tensor([0.2, 0.0, 4.0]))
    assert above < v, "-y is up"
    above_z = Camera.look_at((3.0, 0.0, 1.0), (0.0, 0.0, 1.0), 30.0, 40, 30, up=(0, 0, 1))
    u, v, _ = above_z.project(torch.tensor([0.0, 1.0, 1.5]))
    assert (float(u), float(v)) == pytest.approx((30.0, 10.0)), "+y is right, +z is up"


def test_a_centered_camera_has_square_pixels() -> None:
    chosen = Camera.centered(turned(), 30, 41, 30)
    assert (chosen.fx, chosen.fy, chosen.cx, chosen.cy) == (30.0, 30.0, 20.5, 15.0)
    assert torch.equal(chosen.world_to_camera, turned())


@pytest.mark.parametrize("up", [(0.0, 0.0, 2.0), (0.0, 0.0, 0.0)])
def test_up_along_the_viewing_direction_raises(up: tuple[float, float, float]) -> None:
    with pytest.raises(CameraError, match="`up` is parallel"):
        Camera.look_at((0, 0, 0), (0, 0, 5), 30.0, 40, 30, up=up)
    with pytest.raises(CameraError, match="`up` is parallel"):
        Camera.look_at((1, 1, 1), (1, 1, 1), 30.0, 40, 30)
