from __future__ import annotations

import numpy as np
import pytest
import torch

from core_rasterizer import Device, GaussianModel, Gaussians
from registry.testing import tiny_scene
from stereogs_plugins.tools.view.subject import Subject, Viewpoint, start_pose, viewpoints_of


def model(device: Device, z: float) -> GaussianModel:
    positions = torch.rand(200, 3, generator=torch.Generator().manual_seed(3)) - 0.5
    positions[:, 2] += z
    ones = torch.full((200,), 0.05)
    return GaussianModel(
        Gaussians.from_points(positions, positions * 0 + 0.5, ones, ones, 0), device
    )


def test_the_start_pose_is_behind_and_above_the_first_camera(device: Device) -> None:
    scene = tiny_scene()
    pose = start_pose(Subject("x", model(device, 3.0), viewpoints_of(scene)))
    first = scene.train[0].camera
    behind = first.world_to_camera.numpy() @ [*pose.position, 1]
    assert pose.extent == scene.extent
    assert behind[2] == pytest.approx(-0.5 * scene.extent)
    assert behind[1] == pytest.approx(-0.25 * scene.extent)  # y points down
    u, v, z = first.project(torch.from_numpy(pose.look_at))
    assert (float(u), float(v)) == pytest.approx((first.cx, first.cy))
    assert float(z) == pytest.approx(3.0, abs=0.1)
    assert pose.distance == pytest.approx(np.hypot(float(z) - behind[2], behind[1]))
    np.testing.assert_allclose(pose.up, [0, -1, 0], atol=1e-12)
    assert np.tan(pose.field_of_view / 2) == pytest.approx(0.5 * first.height / first.fy)


def test_an_empty_view_still_has_an_orbit_point(device: Device) -> None:
    scene = tiny_scene()
    pose = start_pose(Subject("x", model(device, -30.0), viewpoints_of(scene)))
    _, _, z = scene.train[0].camera.project(torch.from_numpy(pose.look_at))
    assert float(z) == pytest.approx(5 * scene.extent)


def test_a_single_camera_has_an_extent_too(device: Device) -> None:
    only = Viewpoint("only", tiny_scene().train[0].camera)
    pose = start_pose(Subject("x", model(device, 3.0), (only,)))
    assert pose.extent == pytest.approx(0.3, abs=0.02)


def test_without_cameras_everything_is_in_view(device: Device) -> None:
    pose = start_pose(Subject("x", model(device, 3.0)))
    np.testing.assert_allclose(pose.look_at, [0, 0, 3], atol=0.1)
    assert pose.position[2] < 2.5
