"""`coarse_to_fine`: start with blurred photographs and view-independent colours (FreeNeRF on Gaussians).

FreeNeRF (Yang et al., CVPR 2023) unmasks the frequency bands of the positional encoding linearly until
iteration T, so that detail cannot explain the few views before the coarse shape is learned. Gaussians have
no such encoding: here the photograph's blur shrinks to 0 and all spherical-harmonic bands are enabled,
linearly until T.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Sample, Sampler, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

MIN_BLUR = 0.2
"""Pixels; a smaller blur changes no 8-bit value."""


class CoarseToFineSettings(Settings):
    until: float = Field(0.9, gt=0, le=1)
    """T as a share of the run. FreeNeRF: 0.9, 0.7 and 0.5 with 3, 6 and 9 views."""
    blur: float = Field(4.0, ge=0, allow_inf_nan=False)
    """Standard deviation of the photograph's blur at the start, pixels; 0 disables the blur."""
    bands: bool = True
    """Increase the number of SH bands in use by fractions of a band, instead of `training.sh_every`."""


class CoarseToFine(Sampler[CoarseToFineSettings]):
    """sigma = (1 - t / T) blur, SH degree = min(1, t / T) times the model's, in iteration t."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with the iteration's blur and SH degree."""
        progress = min(1.0, step.iteration / (self.settings.until * step.iterations))
        degree = progress * step.model.sh_degree if self.settings.bands else sample.sh_degree
        sigma = (1 - progress) * self.settings.blur
        target = _blurred(sample.target, sigma) if sigma >= MIN_BLUR else sample.target
        return replace(sample, target=target, sh_degree=degree)


def _blurred(image: Tensor, sigma: float) -> Tensor:
    """Blur an image `[H, W, 3]` in [0, 1] by a Gaussian of `sigma` pixels, mirrored at the border."""
    import torch
    from scipy.ndimage import gaussian_filter  # type: ignore[attr-defined]

    smooth = gaussian_filter(image.numpy(), (sigma, sigma, 0), mode="reflect", truncate=3.0)
    return torch.from_numpy(smooth).clamp(0, 1)


@hookimpl
def stereogs_register_samplers(register: Register[CoarseToFine]) -> None:
    register("coarse_to_fine", CoarseToFine)
