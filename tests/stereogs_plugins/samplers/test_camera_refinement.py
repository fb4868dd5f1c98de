from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry import Scene, View
from registry.testing import step_of
from stereogs_plugins.samplers.camera_refinement import CameraRefinement, rigid_motion
from tests.stereogs_plugins.building import build

FOCAL = 60.0
PIXEL = 1 / FOCAL
"""The rotation, radians, that moves what is in the middle of the image by a pixel."""


def test_the_motion_is_the_exponential_of_its_twist() -> None:
    """In closed form: Rodrigues' R, and V v with V = I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2."""
    from scipy.spatial.transform import Rotation

    omega, v = torch.tensor([[0.3, -0.5, 0.2], [1.0, 2.0, -0.7]], dtype=torch.float64)
    angle = omega.norm()
    cross = torch.linalg.cross(omega.expand(3, 3), torch.eye(3, dtype=torch.float64)).T
    mean = (
        torch.eye(3)
        + (1 - angle.cos()) / angle**2 * cross
        + (angle - angle.sin()) / angle**3 * cross @ cross
    )
    moved = rigid_motion(omega, v)
    expected = torch.from_numpy(Rotation.from_rotvec(omega.numpy()).as_matrix())
    torch.testing.assert_close(moved[:3, :3], expected)
    torch.testing.assert_close(moved[:3, 3], mean @ v)
    assert moved[3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("scale", [0.0, 0.5])
def test_the_gradient_of_the_motion_is_that_of_finite_differences(scale: float) -> None:
    twist = scale * torch.tensor([0.3, -0.5, 0.2, 1.0, 2.0, -0.7], dtype=torch.float64)
    twist.requires_grad_()
    assert torch.autograd.gradcheck(lambda t: rigid_motion(t[:3], t[3:]), (twist,))


def blobs() -> GaussianModel:
    """Coloured Gaussians at several depths before three cameras."""
    draw = torch.Generator().manual_seed(3)
    count = 60
    positions = torch.rand(count, 3, generator=draw) * torch.tensor([3.0, 2.2, 2.0])
    positions += torch.tensor([-1.5, -1.1, 3.0])
    colors = torch.rand(count, 3, generator=draw)
    sizes, opacities = torch.full((count,), 0.15), torch.full((count,), 0.8)
    return GaussianModel(
        Gaussians.from_points(positions, colors, sizes, opacities, 0), open_device()
    )


def pose(x: float) -> Tensor:
    moved = torch.eye(4, dtype=torch.float64)
    moved[0, 3] = -x
    return moved


def scene_of(model: GaussianModel, turns: list[Tensor]) -> tuple[Scene, list[Camera]]:
    """Photographs by true cameras, told to be by turned ones; and the true cameras."""
    true = [Camera(pose(x), FOCAL, FOCAL, 32, 24, 64, 48) for x in (-0.4, 0.0, 0.4)]
    none = torch.zeros(3, dtype=torch.float64)
    views = []
    for index, (camera, turn) in enumerate(zip(true, turns, strict=True)):
        with torch.no_grad():
            image = model.render(camera).rgb.clamp(0, 1)
        told = replace(camera, world_to_camera=rigid_motion(turn, none) @ camera.world_to_camera)
        views.append(View(str(index), told, image))
    return Scene("blobs", tuple(views), (), (2.0, 6.0)), true


def test_cameras_that_are_off_by_half_a_pixel_come_back() -> None:
    model = blobs()
    directions = torch.randn(3, 3, generator=torch.Generator().manual_seed(1)).double()
    turns = 0.5 * PIXEL * (directions - directions.mean(dim=0))
    scene, true = scene_of(model, list(turns))
    sampler = build(CameraRefinement, rotation_rate=5e-4, translation_rate=0.0)
    sampler.begin_training(scene.for_training())
    adam = torch.optim.Adam(
        [{"params": g.tensors, "lr": g.learning_rate} for g in sampler.parameters()]
    )
    step = step_of(model, scene)

    def seen(index: int) -> Camera:
        view = scene.train[index].for_training()
        sample = replace(step.sample, view=view, camera=view.camera)
        return sampler.sample(step, sample).camera

    def error(index: int) -> float:
        """Radians between the true orientation and the one in use."""
        off = seen(index).world_to_camera.detach()[:3, :3] @ true[index].camera_to_world[:3, :3]
        return float(torch.linalg.matrix_norm(off - torch.eye(3))) / 2**0.5

    before = sum(error(index) for index in range(3))
    for iteration in range(180):
        index = iteration % 3
        adam.zero_grad(set_to_none=True)
        rendering = model.render(seen(index))
        (rendering.rgb - scene.train[index].image).square().mean().backward()
        adam.step()
    assert sum(error(index) for index in range(3)) < 0.2 * before


def test_the_mean_motion_is_zero_and_a_view_moves_itself_alone() -> None:
    scene, _ = scene_of(blobs(), [torch.zeros(3, dtype=torch.float64)] * 3)
    sampler = build(CameraRefinement)
    sampler.begin_training(scene.for_training())
    rotations, translations = (group.tensors for group in sampler.parameters())
    with torch.no_grad():
        for index in range(3):
            rotations[index].fill_(0.01 * 2**index)
            translations[index].fill_(0.02 * 3**index)
    step = step_of(blobs(), scene)
    moved = [
        sampler.sample(step, replace(step.sample, view=view, camera=view.camera)).camera
        for view in step.scene.train
    ]
    logs = [
        torch.linalg.matrix_norm(
            camera.world_to_camera.detach() @ view.camera.camera_to_world - torch.eye(4)
        )
        for camera, view in zip(moved, scene.train, strict=True)
    ]
    assert min(logs) > 1e-3
    kept = torch.stack([sampler._rotations.of(v) for v in scene.train]).detach()
    torch.testing.assert_close(kept.sum(dim=0), torch.zeros(3, dtype=torch.float64))
    moved[1].world_to_camera.sum().backward()
    assert [t.grad is not None for t in rotations] == [False, True, False]
