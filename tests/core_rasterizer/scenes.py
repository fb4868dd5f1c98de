"""Small scenes for the engine's tests."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, Gaussians, Rendering, reference
from core_rasterizer.layout import PARAMETER_GROUPS, PARAMETERS

NAMES = ("means", "quaternions", "scales", "opacities", "sh")
"""Arguments of `rasterize`."""

Leaves = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


@dataclass
class Scene:
    """Arguments of `rasterize` in float64, leaves of autograd."""

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor

    def tensors(self, dtype: torch.dtype = torch.float64) -> Leaves:
        """Fresh leaves in the order of `rasterize`'s arguments."""
        fields = (self.means, self.quaternions, self.scales, self.opacities, self.sh)
        return fresh(fields, dtype)


def fresh(values: Leaves, dtype: torch.dtype | None = None) -> Leaves:
    """Leaves of autograd with the values, of the given type if one is given."""
    means, quaternions, scales, opacities, sh = (
        value.detach().clone().to(dtype or value.dtype).requires_grad_() for value in values
    )
    return means, quaternions, scales, opacities, sh


def gradient(leaf: Tensor) -> Tensor:
    """The gradient of a leaf, which must have one."""
    assert leaf.grad is not None
    return leaf.grad


def random_camera(generator: torch.Generator, width: int = 40, height: int = 28) -> Camera:
    """A camera near the origin that looks along +z, turned a little, with an off-centre principal point."""

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator))

    angles = [uniform(-0.3, 0.3) for _ in range(3)]
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.matrix_exp(_cross(torch.tensor(angles, dtype=torch.float64)))
    pose[:3, 3] = torch.tensor([uniform(-0.2, 0.2) for _ in range(3)], dtype=torch.float64)
    return Camera(
        pose,
        fx=uniform(0.7, 1.6) * width,
        fy=uniform(0.7, 1.6) * width,
        cx=uniform(0.3, 0.7) * width,
        cy=uniform(0.3, 0.7) * height,
        width=width,
        height=height,
    )


def random_scene(
    generator: torch.Generator, count: int, sh_degree: int = 3, spread: float = 1.2
) -> Scene:
    """Gaussians in front of `random_camera`; `spread` above 1 puts some outside the image."""

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        values = torch.rand(*shape, generator=generator, dtype=torch.float64)
        return low + (high - low) * values

    z = uniform(1.5, 6.0, count)
    directions = uniform(-spread / 2, spread / 2, count, 2)
    return Scene(
        means=torch.stack((directions[:, 0] * z, directions[:, 1] * z, z), dim=1),
        quaternions=torch.randn(count, 4, generator=generator, dtype=torch.float64),
        scales=torch.exp(uniform(-3.5, -0.7, count, 3)),
        opacities=uniform(0.05, 0.95, count),
        sh=0.3
        * torch.randn(count, (sh_degree + 1) ** 2, 3, generator=generator, dtype=torch.float64),
    )


def random_gaussians(count: int, degree: int, seed: int) -> Gaussians:
    """Normally distributed parameters, not to be looked at."""
    generator = torch.Generator().manual_seed(seed)
    shapes = {"means": (3,), "log_scales": (3,), "quaternions": (4,), "opacity_logits": ()}
    shapes["sh"] = ((degree + 1) ** 2, 3)
    return Gaussians(
        **{n: torch.randn(count, *shape, generator=generator) for n, shape in shapes.items()}
    )


def parameters(count: int = 200, seed: int = 0, sh_degree: int = 3) -> Gaussians:
    """A `random_scene` as a model stores it."""
    return stored(random_scene(torch.Generator().manual_seed(seed), count, sh_degree))


def stored(scene: Scene) -> Gaussians:
    """Logarithms and logits, in float."""
    return Gaussians(
        means=scene.means.float(),
        log_scales=scene.scales.log().float(),
        quaternions=scene.quaternions.float(),
        opacity_logits=torch.logit(scene.opacities).float(),
        sh=scene.sh.float(),
    )


def view(seed: int = 0) -> Camera:
    """A camera for `parameters`."""
    return random_camera(torch.Generator().manual_seed(50 + seed), 90, 60)


def activated(stored: Gaussians, dtype: torch.dtype = torch.float64) -> Leaves:
    """The arguments of `rasterize` and of the reference for stored parameters."""
    values = {name: getattr(stored, name).to(dtype) for name in PARAMETERS}
    scales, opacities = values["log_scales"].exp(), values["opacity_logits"].sigmoid()
    return values["means"], values["quaternions"], scales, opacities, values["sh"]


def leaves_of(gaussians: Gaussians, dtype: torch.dtype = torch.float32) -> Gaussians:
    """Copies that are leaves of autograd."""
    return Gaussians(
        **{n: getattr(gaussians, n).to(dtype).clone().requires_grad_() for n in PARAMETERS}
    )


def with_centers(
    gaussians: Gaussians, camera: Camera
) -> tuple[reference.Projected, Tensor, Rendering]:
    """The reference's projection, its centres on the image as a leaf, and the image computed from them."""
    projected = reference.project(*activated(gaussians), camera)
    centers = projected.centers.detach().requires_grad_()
    moved = projected._replace(centers=centers)
    return projected, centers, reference.composite(moved, camera.width, camera.height)


def rates(rate: float) -> dict[str, float]:
    """The same learning rate for every group."""
    return dict.fromkeys(PARAMETER_GROUPS, rate)


def gradients_of(model: GaussianModel) -> dict[str, Tensor]:
    """Copies of the gradients of all parameters."""
    return {name: model.gradient(name).clone() for name in PARAMETERS}


def weighted_loss(rendering: Rendering, seed: int) -> Tensor:
    """A loss on every output with random weights."""
    generator = torch.Generator().manual_seed(seed)
    total = torch.zeros((), dtype=rendering.rgb.dtype)
    for image in (rendering.rgb, rendering.depth, rendering.alpha):
        weights = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        total = total + (image * weights.to(image.dtype)).sum()
    return total


def relative_error(value: Tensor, truth: Tensor) -> float:
    """Largest error over the largest true value."""
    error = (value.detach().double() - truth.detach()).abs().max()
    return float(error / truth.detach().abs().max().clamp(min=1e-30))


def _cross(vector: Tensor) -> Tensor:
    x, y, z = vector.tolist()
    return torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
