"""`near_occlusion`: penalize Gaussians right in front of the camera (FreeNeRF, Yang et al. 2023).

The paper averages the density of the first M samples of each ray. Here only the Gaussians up to the depth of
sample M are rendered; the alpha of this render is their contribution to the image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class NearOcclusionSettings(Settings):
    share: float = Field(20 / 128, gt=0, le=1)
    """Penalized share of the range from near to far bound: M / 128 in FreeNeRF, M = 20 on LLFF, 10 on DTU."""


class NearOcclusion(Regularizer[NearOcclusionSettings]):
    """Mean alpha of the Gaussians with z < near + share (far - near), in the iteration's view."""

    host_defaults = HostDefaults(weight=0.01)

    def loss(self, step: Step) -> Tensor:
        """Return the loss; 0 if no Gaussian is in the range."""
        import torch

        near, far = step.scene.bounds
        camera = step.sample.camera
        with torch.no_grad():
            _, _, z = camera.project(step.model.read("means"))
            close = z < near + self.settings.share * (far - near)
        if not close.any():
            return torch.zeros(())
        return step.render(camera, opacity_scale=close.float()).alpha.mean()


@hookimpl
def stereogs_register_regularizers(register: Register[NearOcclusion]) -> None:
    register("near_occlusion", NearOcclusion)
