"""`opacity_noise`: multiply opacities by noise in each training render (Chen et al. 2025, Quantifying and
Alleviating Co-Adaptation in Sparse-View 3D Gaussian Splatting).

With few views, Gaussians learn to cancel each other's errors in the training views only; noise on their
opacities prevents that. Its mean is 1, so that renders without noise are close to the trained ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Modifier, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class OpacityNoiseSettings(Settings):
    sigma: float = Field(0.8, ge=0, le=1)
    """Standard deviation of the factors, before they are clamped to [1 - sigma, 1 + sigma]."""


class OpacityNoise(Modifier[OpacityNoiseSettings]):
    """Opacity factors 1 + sigma * normal noise; the noise is clamped to [-1, 1] and the opacity to 1."""

    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors."""
        import torch

        noise = torch.randn(step.model.count, generator=self.generator).clamp(-1, 1)
        return (1 + self.settings.sigma * noise).minimum(1 / step.model.opacities())


@hookimpl
def stereogs_register_modifiers(register: Register[OpacityNoise]) -> None:
    register("opacity_noise", OpacityNoise)
