"""Small scenes for the engine's tests."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core_rasterizer import Camera

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


def _cross(vector: Tensor) -> Tensor:
    x, y, z = vector.tolist()
    return torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
