"""Helpers of the stress tests: a camera, a render with its gradients, and checks."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import Camera, Device, Rendering, rasterize, reference
from core_rasterizer.raster import NEAR_PLANE
from tests.core_rasterizer.scenes import (
    NAMES,
    Scene,
    fresh,
    random_scene,
    relative_error,
    weighted_loss,
)

BACKGROUND = (0.2, 0.5, 0.9)

Gradients = dict[str, Tensor]


def plain_camera(width: int = 48, height: int = 36, focal: float = 50.0) -> Camera:
    """At the origin, looking along +z, centred."""
    return Camera(torch.eye(4), focal, focal, width / 2, height / 2, width, height)


def crowd(count: int = 12, sh_degree: int = 1, seed: int = 0) -> Scene:
    """Ordinary Gaussians in view of `plain_camera`, the first of them in the middle of the image."""
    scene = random_scene(torch.Generator().manual_seed(seed), count, sh_degree, spread=0.6)
    if count:
        scene.means[0] = torch.tensor([0.0, 0.0, 2.0])
        scene.opacities[0] = 0.8
    return scene


def there_and_back(
    scene: Scene,
    camera: Camera,
    device: Device,
    dtype: torch.dtype = torch.float32,
    near: float = NEAR_PLANE,
) -> tuple[Rendering, Gradients]:
    """Render and differentiate a loss on all outputs; check that all results are finite."""
    leaves = scene.tensors(dtype)
    rendering = rasterize(*leaves, camera, BACKGROUND, near=near, device=device)
    weighted_loss(rendering, 0).backward()
    gradients = {}
    for name, leaf in zip(NAMES, leaves, strict=True):
        assert leaf.grad is not None
        assert leaf.grad.shape == leaf.shape
        gradients[name] = leaf.grad
        assert torch.isfinite(leaf.grad).all(), f"the gradient of {name} is not finite"
    for name in ("rgb", "depth", "alpha"):
        assert torch.isfinite(getattr(rendering, name)).all(), f"{name} is not finite"
    return rendering, gradients


def assert_nothing_seen(rendering: Rendering, gradients: Gradients) -> None:
    """Check that the image is the background, without gradient."""
    assert torch.equal(rendering.rgb, torch.tensor(BACKGROUND).expand_as(rendering.rgb))
    assert not rendering.depth.any()
    assert not rendering.alpha.any()
    assert all(not gradient.any() for gradient in gradients.values())


def assert_invisible(scene: Scene, index: int, camera: Camera, device: Device) -> None:
    """Check that one Gaussian has no effect on the image, its gradient or the others' bits."""
    rendering, gradients = there_and_back(scene, camera, device)
    others = torch.arange(len(scene.means)) != index
    fields = (getattr(scene, name)[others] for name in NAMES)
    alone, expected = there_and_back(Scene(*fields), camera, device)
    for name in ("rgb", "depth", "alpha"):
        assert torch.equal(getattr(rendering, name), getattr(alone, name)), name
    for name in NAMES:
        assert not gradients[name][index].any(), name
        assert torch.equal(gradients[name][others], expected[name]), name


def assert_agrees_with_oracle(
    scene: Scene,
    camera: Camera,
    device: Device,
    dtype: torch.dtype = torch.float32,
    image_tolerance: float = 1e-5,
    gradient_tolerance: float = 2e-4,
) -> None:
    """Images and gradients are those of the float64 oracle for the parameters as the device has them."""
    rendering, gradients = there_and_back(scene, camera, device, dtype)
    leaves = fresh(scene.tensors(dtype), torch.float64)
    truth = reference.render(*leaves, camera, BACKGROUND)
    weighted_loss(truth, 0).backward()
    for name in ("rgb", "depth", "alpha"):
        error = relative_error(getattr(rendering, name), getattr(truth, name))
        assert error < image_tolerance, f"{name} {error:.1e}"
    for name, leaf in zip(NAMES, leaves, strict=True):
        assert leaf.grad is not None
        if leaf.grad.abs().max() > 1e-12:
            error = relative_error(gradients[name], leaf.grad)
            assert error < gradient_tolerance, f"gradient of {name} {error:.1e}"
