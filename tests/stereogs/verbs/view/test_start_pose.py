from __future__ import annotations

import numpy as np
import pytest
import torch

from core_rasterizer import Device, GaussianModel, Gaussians
from registry.testing import tiny_scene
from stereogs.verbs.view.subject import Subject, Viewpoint, start_pose, viewpoints_of


def model(device: Device, z: float) -> GaussianModel:
    positions = torch.rand(200, 3, generator=torch.Generator().manual_seed(3)) - 0.5
    positions[:, 2] += z
    ones = torch.full((200,), 0.05)
    return GaussianModel(
        Gaussians.from_points(positions, positions * 0 + 0.5, ones, ones, 0), device
    )


def test_the_start_pose_is_a_training_camera_upright(device: Device) -> None:
    scene = tiny_scene()
    pose = start_pose(Subject("x", model(device, 3.0), viewpoints_of(scene)))
    centers = torch.stack([view.camera.center for view in scene.train])
    index = int((centers - centers.mean(dim=0)).norm(dim=1).argmin())
    central = scene.train[index].camera
    np.testing.assert_allclose(pose.position, central.center.numpy())
    assert pose.extent == scene.extent
    u, v, z = central.project(torch.from_numpy(pose.look_at))
    assert (float(u), float(v)) == pytest.approx((central.cx, central.cy))
    assert float(z) == pytest.approx(3.0, abs=0.1)
    assert pose.distance == pytest.approx(float(z))
    np.testing.assert_allclose(pose.up, [0, -1, 0], atol=1e-12)
    assert np.tan(pose.field_of_view / 2) == pytest.approx(0.5 * central.height / central.fy)


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
