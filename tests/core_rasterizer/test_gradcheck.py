"""Gradcheck of the kernels in double on two hundred random scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Device, rasterize
from tests.core_rasterizer.options import smoothing_of
from tests.core_rasterizer.scenes import Scene, random_camera, random_scene

SCENES, PER_TEST = 208, 16
FIRSTS = [
    pytest.param(first, marks=pytest.mark.proof if first else ())
    for first in range(0, SCENES, PER_TEST)
]
"""The number of each test's first scene: sixteen scenes in the suite, which have each combination of
degree, half a band and filters; the others among the proofs."""


def smooth_scene(generator: torch.Generator, sh_degree: int) -> Scene:
    """Gaussians far from all thresholds, where finite differences would be wrong.

    They are wide enough that their 1/255 contour lies outside the small image, faint enough that no
    alpha reaches 0.99 and no pixel finishes, and bright enough that no colour is clamped at 0.
    """
    scene = random_scene(generator, 4, sh_degree=sh_degree, spread=0.5)
    scene.scales = 3.0 + 2.0 * torch.rand(4, 3, generator=generator, dtype=torch.float64)
    scene.opacities = 0.2 + 0.3 * torch.rand(4, generator=generator, dtype=torch.float64)
    scene.sh[:, 0] += 2.0
    return scene


def beyond_the_clamp(scene: Scene, camera: Camera) -> None:
    """Put two Gaussians where the Jacobian's x/z and y/z are clamped: right of and below the image."""
    z = scene.means[:2, 2]
    right = (camera.width - camera.cx + 0.6 * camera.width) / camera.fx
    below = (camera.height - camera.cy + 0.6 * camera.height) / camera.fy
    local = torch.stack((right * z, below * z, z), dim=1)
    pose = camera.camera_to_world
    scene.means[:2] = local @ pose[:3, :3].T + pose[:3, 3]
    scene.scales[:2] *= 3


def filtered(scene: Scene, generator: torch.Generator) -> dict[str, Any]:
    """Filters with a visible effect on these wide Gaussians, which become more opaque."""
    scene.opacities *= 1.8
    return {
        "dilation": 30.0,
        "compensate_dilation": True,
        "smoothing": smoothing_of(generator, 4, largest=2.0),
    }


def images(
    device: Device, cameras: list[Camera], background: list[float], **options: Any
) -> Callable[..., Tensor]:
    """Colour, depth and alpha of several renders as one output, for one backward pass.

    The function's arguments are those of `rasterize`, and then, if they are to be checked, poses.
    """

    def render(*leaves: Tensor) -> Tensor:
        outputs = []
        means, quaternions, scales, opacities, sh, *given = leaves
        scene = (means, quaternions, scales, opacities, sh)
        poses = given or [camera.world_to_camera for camera in cameras]
        for camera, pose in zip(cameras, poses, strict=True):
            posed = replace(camera, world_to_camera=pose)
            rendering = rasterize(*scene, posed, background, **options, device=device)
            outputs += [rendering.rgb.reshape(-1), rendering.depth.reshape(-1)]
            outputs += [rendering.alpha.reshape(-1)]
        return torch.cat(outputs)

    return render


@pytest.mark.parametrize("first", FIRSTS)
def test_the_kernels_pass_gradcheck(device: Device, first: int) -> None:
    """Every parameter, off-centre cameras, background, the clamp, two renders in one backward."""
    for seed in range(first, first + PER_TEST):
        generator = torch.Generator().manual_seed(1000 + seed)
        cameras = [random_camera(generator, 9, 7) for _ in range(1 + seed % 2)]
        scene = smooth_scene(generator, sh_degree=seed % 4)
        if seed % 3 == 0:
            beyond_the_clamp(scene, cameras[0])
        background = torch.rand(3, generator=generator).tolist()
        function = images(device, cameras, background)
        assert torch.autograd.gradcheck(
            function, scene.tensors(), eps=1e-5, atol=1e-7, rtol=1e-6, fast_mode=True
        ), seed


@pytest.mark.parametrize("first", FIRSTS)
def test_poses_and_filters_pass_gradcheck(device: Device, first: int) -> None:
    """The same scenes with the cameras' poses, half of them through every filter, with half a band."""
    for seed in range(first, first + PER_TEST):
        generator = torch.Generator().manual_seed(1000 + seed)
        cameras = [random_camera(generator, 9, 7) for _ in range(1 + seed % 2)]
        scene = smooth_scene(generator, sh_degree=seed % 4)
        if seed % 3 == 0:
            beyond_the_clamp(scene, cameras[0])
        options: dict[str, Any] = filtered(scene, generator) if seed // 4 % 2 else {}
        options["sh_degree"] = max(0.0, seed % 4 - 0.5 * (seed // 8 % 2))
        function = images(device, cameras, [0.1, 0.2, 0.3], **options)
        poses = [camera.world_to_camera.clone().requires_grad_() for camera in cameras]
        assert torch.autograd.gradcheck(
            function, (*scene.tensors(), *poses), eps=1e-5, atol=1e-7, rtol=1e-6, fast_mode=True
        ), seed
