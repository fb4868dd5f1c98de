"""Depth bounds from points, from the common focus of cameras, and from baselines."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from core_rasterizer import Camera
from registry import PointCloud, SceneError
from registry.toolkit.photos import estimate_bounds


def looking_at_origin(angle: float, radius: float = 4.0) -> Camera:
    rotation = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = rotation, radius
    return Camera(torch.from_numpy(pose), 40, 40, 16, 12, 32, 24)


def test_bounds_from_visible_points() -> None:
    camera = looking_at_origin(0)
    depths = torch.linspace(2, 10, 1001)
    positions = torch.stack([torch.zeros(1001), torch.zeros(1001), depths - 4], dim=1)
    outside = torch.tensor([[50.0, 0, 0], [0, 0, -100]])  # outside the image, and behind the camera
    positions = torch.cat([positions, outside])
    near, far = estimate_bounds([camera], PointCloud(positions, torch.zeros(1003, 3)), "")
    assert (near, far) == pytest.approx((2 / 1.1, 10 * 1.1), rel=0.01)


def test_points_on_the_border_of_the_image_count() -> None:
    camera = Camera(torch.eye(4), 32, 32, 16, 12, 32, 24)
    depths = torch.arange(2, 11).float().repeat(5)
    positions = torch.stack([depths / 2, 0 * depths, depths], dim=1)  # u = 32
    near, far = estimate_bounds([camera], PointCloud(positions, torch.zeros(45, 3)), "")
    assert (near, far) == pytest.approx((2 / 1.1, 10 * 1.1))


def test_bounds_from_the_point_that_cameras_look_at() -> None:
    cameras = [looking_at_origin(0.3, 4.0), looking_at_origin(-0.3, 6.0)]
    assert estimate_bounds(cameras, None, "") == pytest.approx((4 / 5, 6 * 5))


def test_bounds_from_baselines_of_parallel_cameras() -> None:
    poses = [torch.eye(4), torch.eye(4)]
    poses[1][0, 3] = 0.5
    cameras = [Camera(pose, 40, 40, 16, 12, 32, 24) for pose in poses]
    assert estimate_bounds(cameras, None, "") == pytest.approx((0.5, 50))


def test_cameras_that_look_apart_fall_back_to_baselines() -> None:
    away = [looking_at_origin(angle, -4.0) for angle in (0.3, -0.3)]
    near, far = estimate_bounds(away, None, "")
    assert far == pytest.approx(100 * near)


def test_one_camera_has_no_bounds() -> None:
    few = PointCloud(torch.zeros(3, 3), torch.zeros(3, 3))
    with pytest.raises(SceneError, match="depth is unknown"):
        estimate_bounds([looking_at_origin(0)], few, "here")
