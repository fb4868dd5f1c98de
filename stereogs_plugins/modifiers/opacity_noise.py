"""`opacity_noise`: in each training render opacities are noisy (Chen et al. 2025, Quantifying and
Alleviating Co-Adaptation in Sparse-View 3D Gaussian Splatting).

With few views Gaussians learn to make up for each other's errors in the training views and in no other.
Where each one's share varies, they cannot count on each other. The noise has mean 1, so that what is
rendered without it is nearly what was trained.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Modifier, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class OpacityNoiseSettings(Settings):
    sigma: float = Field(0.8, ge=0, le=1)
    """Standard deviation of the factors, which are then kept within 1 - sigma and 1 + sigma."""


class OpacityNoise(Modifier[OpacityNoiseSettings]):
    """Opacity factors 1 + sigma * normal noise, the noise kept in [-1, 1] and the opacity below 1."""

    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors."""
        import torch

        noise = torch.randn(step.model.count, generator=self.generator).clamp(-1, 1)
        return (1 + self.settings.sigma * noise).minimum(1 / step.model.opacities())


@hookimpl
def stereogs_register_modifiers(register: Register[OpacityNoise]) -> None:
    register("opacity_noise", OpacityNoise)
