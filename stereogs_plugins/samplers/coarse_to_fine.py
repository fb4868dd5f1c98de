"""`coarse_to_fine`: begin with blurred photographs and colours without direction (FreeNeRF on Gaussians).

FreeNeRF (Yang et al., CVPR 2023) unmasks the bands of a positional encoding linearly until a
moment T, so that few views cannot be explained by detail before the coarse shape stands. Gaussians have
no such encoding: here the photograph's blur shrinks to nothing and the spherical-harmonic bands grow to
all, linearly until T.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Sample, Sampler, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

SMALLEST_BLUR = 0.2
"""Pixels; less changes no pixel by a grey level."""


class CoarseToFineSettings(Settings):
    until: float = Field(0.9, gt=0, le=1)
    """T as a share of the run. FreeNeRF: 0.9, 0.7 and 0.5 with 3, 6 and 9 views."""
    blur: float = Field(4.0, ge=0, allow_inf_nan=False)
    """Standard deviation of the photograph's blur at the start, pixels; 0 leaves it sharp."""
    bands: bool = True
    """Let the SH bands in use grow, a fraction of a band at a time, in place of `training.sh_every`."""


class CoarseToFine(Sampler[CoarseToFineSettings]):
    """sigma = (1 - t / T) blur, SH degree = min(1, t / T) times the model's; t counts iterations."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample as coarse as it is due."""
        progress = min(1.0, step.iteration / (self.settings.until * step.iterations))
        degree = progress * step.model.sh_degree if self.settings.bands else sample.sh_degree
        sigma = (1 - progress) * self.settings.blur
        target = _blurred(sample.target, sigma) if sigma >= SMALLEST_BLUR else sample.target
        return replace(sample, target=target, sh_degree=degree)


def _blurred(image: Tensor, sigma: float) -> Tensor:
    """`[H, W, 3]` in [0, 1] through a Gaussian of `sigma` pixels; beyond the edge it is mirrored."""
    import torch
    from scipy.ndimage import gaussian_filter  # type: ignore[attr-defined]

    smooth = gaussian_filter(image.numpy(), (sigma, sigma, 0), mode="reflect", truncate=3.0)
    return torch.from_numpy(smooth).clamp(0, 1)


@hookimpl
def stereogs_register_samplers(register: Register[CoarseToFine]) -> None:
    register("coarse_to_fine", CoarseToFine)
