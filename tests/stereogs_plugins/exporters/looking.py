"""A small scene of Gaussians that differ in every parameter, and how alike two of them look."""

from __future__ import annotations

import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry.testing import tiny_scene

SCENE = tiny_scene()
CAMERAS = [view.camera.resized(96, 72) for view in (*SCENE.train, *SCENE.test)]


def colorful(count: int = 60) -> Gaussians:
    """Stretched, turned Gaussians with three bands of colour in view of the scene's cameras."""
    generator = torch.Generator().manual_seed(5)
    means = torch.rand(count, 3, generator=generator) * 2 - 1
    means[:, 2] += 3
    return Gaussians(
        means=means,
        log_scales=torch.rand(count, 3, generator=generator) * 1.5 - 3,
        quaternions=torch.randn(count, 4, generator=generator),
        opacity_logits=torch.randn(count, generator=generator),
        sh=torch.randn(count, 16, 3, generator=generator) * 0.25,
    )


def likeness(first: Gaussians, second: Gaussians, moved: torch.Tensor | None = None) -> float:
    """The least PSNR in decibels between pictures of both, over all cameras.

    Args:
        moved: `[4, 4]`, takes world coordinates of the second to those of the first.
    """
    one, other = (GaussianModel(gaussians, open_device()) for gaussians in (first, second))
    worst = float("inf")
    for camera in CAMERAS:
        pose = camera.world_to_camera if moved is None else camera.world_to_camera @ moved
        seen = Camera(pose, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        with torch.no_grad():
            error = (one.render(camera).rgb - other.render(seen).rgb).square().mean()
        worst = min(worst, float(-10 * torch.log10(error.clamp(min=1e-12))))
    return worst
