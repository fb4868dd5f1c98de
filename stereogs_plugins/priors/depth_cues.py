"""`depth_cues`: relative inverse depth of one image from two pictorial cues; needs no model file.

Height in the image (Torralba and Oliva, PAMI 2002): a ground plane is nearer towards the lower edge.
Sharpness (Pentland, PAMI 1987): photographers focus on near objects. A weak substitute for a monocular
network, so that methods that need one run without a file.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Settings, hookimpl
from registry.priors import MonocularDepthPrior

if TYPE_CHECKING:
    from torch import Tensor


class DepthCuesSettings(Settings):
    sharpness: float = Field(0.5, ge=0, le=1)
    """Weight of sharpness; the rest is the weight of height in the image."""
    radius: float = Field(0.016, gt=0)
    """Standard deviation of the Gaussian that averages sharpness, relative to the shorter side."""


class DepthCues(MonocularDepthPrior[DepthCuesSettings]):
    """The weighted mean of each pixel's rank by height and its rank by local sharpness."""

    def estimate(self, image: Tensor) -> Tensor:
        """Relative inverse depth `[H, W]` in [0, 1], larger = nearer."""
        import torch
        from kornia.filters import gaussian_blur2d, spatial_gradient

        height, width = image.shape[:2]
        sigma = self.settings.radius * min(height, width)
        reach = 2 * math.ceil(3 * sigma) + 1
        grey = image.mean(dim=2)[None, None]
        slope = spatial_gradient(grey, mode="diff")[0, 0].square().sum(dim=0).sqrt()
        mean = gaussian_blur2d(slope[None, None], reach, (sigma, sigma), border_type="replicate")
        sharpness = torch.empty(height * width)
        order = mean.flatten().argsort(stable=True)
        sharpness[order] = torch.linspace(0, 1, height * width)
        rows = torch.linspace(0, 1, height)[:, None].expand(height, width)
        return torch.lerp(rows, sharpness.reshape(height, width), self.settings.sharpness)


@hookimpl
def stereogs_register_priors(register: Register[DepthCues]) -> None:
    register("depth_cues", DepthCues)
