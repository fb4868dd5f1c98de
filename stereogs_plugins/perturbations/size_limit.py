"""`size_limit`: limit the size of Gaussians in all training images.

With few photographs most of space is unobserved. At the high learning rates of a short training, Gaussians
can grow there beyond the size of the scene, which novel views show as haze. 3D Gaussian Splatting (Kerbl
et al. 2023, the authors' code) prunes Gaussians of more than 20 pixels; here only their size is limited,
since with few views nothing else may cover the area.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor


class SizeLimitSettings(Settings):
    angle: float = Field(0.1, gt=0, allow_inf_nan=False)
    """Largest scale, relative to the distance to the nearest training camera; approximately radians."""


class SizeLimit(Perturbation[SizeLimitSettings]):
    """scale <- min(scale, angle * distance to the nearest training camera), for each axis."""

    host_defaults = HostDefaults(every=10)

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the offsets of the logarithms of the scales, `[N, 3]`, at most 0."""
        import torch

        means, log_scales = step.model.read("means"), step.model.read("log_scales")
        cameras = (view.camera.center.to(means) for view in step.scene.train)
        # `torch.cdist` takes seven times as long, and subtracts squares of positions.
        squares = ((means - camera).square().sum(dim=1, keepdim=True) for camera in cameras)
        distance = reduce(torch.minimum, squares).sqrt()
        limit = self.settings.angle * distance.clamp(min=1e-6 * step.extent)  # avoids log(0)
        return {"log_scales": (limit.log() - log_scales).clamp(max=0)}


@hookimpl
def stereogs_register_perturbations(register: Register[SizeLimit]) -> None:
    register("size_limit", SizeLimit)
