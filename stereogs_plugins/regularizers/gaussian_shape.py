"""`gaussian_shape`: keep Gaussians round, small and opaque (DNGaussian, Li et al. 2024).

Three losses on the parameters, each with its own weight; the defaults are the authors' for LLFF.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

FAINT = 0.2
"""Opacities up to this value are averaged separately from those above; the loss increases both."""


class GaussianShapeSettings(Settings):
    elongation: float = Field(0.002, ge=0, allow_inf_nan=False)
    """Weight of the mean of each Gaussian's largest scale over its smallest."""
    size: float = Field(0.001, ge=0, allow_inf_nan=False)
    """Weight of the mean square of the largest scales, in the frame of training (typical depth 8)."""
    opacity: float = Field(0.001, ge=0, allow_inf_nan=False)
    """Weight of 1 - mean o^2 over opacities o > 0.2, plus mean (1 - o)^2 over those below."""


class GaussianShape(Regularizer[GaussianShapeSettings]):
    """elongation mean(max s / min s) + size mean (max s)^2 + opacity (1 - mean o^2 + mean (1 - o)^2)."""

    def loss(self, step: Step) -> Tensor:
        """Return the weighted sum."""
        scales, opacities = step.parameter("scales"), step.parameter("opacities")
        largest, smallest = scales.amax(dim=1), scales.amin(dim=1)
        settings = self.settings
        return (
            settings.elongation * (largest / smallest).mean()
            + settings.size * largest.square().mean()
            + settings.opacity * _faintness(opacities)
        )


def _faintness(opacities: Tensor) -> Tensor:
    """Return the opacity loss; an empty side contributes 0."""
    opaque, faint = opacities[opacities > FAINT], opacities[opacities <= FAINT]
    term = opacities.new_zeros(())
    if len(opaque):
        term = term + 1 - opaque.square().mean()
    if len(faint):
        term = term + (1 - faint).square().mean()
    return term


@hookimpl
def stereogs_register_regularizers(register: Register[GaussianShape]) -> None:
    register("gaussian_shape", GaussianShape)
