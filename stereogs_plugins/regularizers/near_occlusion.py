"""`near_occlusion`: what floats right before the camera is penalized (FreeNeRF, Yang et al. 2023).

The paper averages the density of the first M samples of each ray. Of Gaussians, those up to the depth of
sample M are rendered alone: nothing is in front of them, so that the alpha of this picture is what they
take away from the photograph.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class NearOcclusionSettings(Settings):
    share: float = Field(20 / 128, gt=0, le=1)
    """How far from near to far bound is too near: M of FreeNeRF's 128 samples, 20 on LLFF, 10 on DTU."""


class NearOcclusion(Regularizer[NearOcclusionSettings]):
    """The mean alpha of the Gaussians with z < near + share (far - near), in the view at hand."""

    def loss(self, step: Step) -> Tensor:
        """The term; 0 while nothing is that near."""
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
