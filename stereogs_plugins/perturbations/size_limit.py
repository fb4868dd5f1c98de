"""`size_limit`: no Gaussian grows to more than a small part of any training picture.

Few photographs leave most of space unseen. With the high rates of a short training, Gaussians grow into it
that no photograph contradicts, larger than the scene, and hang before the next camera as haze.
3D Gaussian Splatting (Kerbl et al. 2023, the authors' code) removes what covers more than 20 pixels on the
screen; here it only stops growing, since with few views nothing else may be there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor


class SizeLimitSettings(Settings):
    angle: float = Field(0.1, gt=0, allow_inf_nan=False)
    """The largest scale, over the distance to the nearest training camera; about radians."""


class SizeLimit(Perturbation[SizeLimitSettings]):
    """scale <- min(scale, angle * distance to the nearest training camera), for each axis."""

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the offsets of the logarithms of the scales, `[N, 3]`, none above 0."""
        import torch

        means, log_scales = step.model.read("means"), step.model.read("log_scales")
        cameras = torch.stack([view.camera.center for view in step.scene.train]).to(means)
        distance = torch.cdist(means, cameras).amin(dim=1, keepdim=True)
        limit = self.settings.angle * distance.clamp(min=1e-6 * step.extent)  # 0 has no logarithm
        return {"log_scales": (limit.log() - log_scales).clamp(max=0)}


@hookimpl
def stereogs_register_perturbations(register: Register[SizeLimit]) -> None:
    register("size_limit", SizeLimit)
