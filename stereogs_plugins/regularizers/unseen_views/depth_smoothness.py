"""`depth_smoothness`: penalize depth gradients in virtual views (RegNeRF on Gaussians).

Niemeyer et al., CVPR 2022. RegNeRF renders a few patches of 8 by 8 pixels; here the whole render is used.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

if TYPE_CHECKING:
    from torch import Tensor


class DepthSmoothnessSettings(Settings):
    views: VirtualViewKind = "box"
    """Positions of the virtual cameras: in a box or on a sphere around the training cameras, or
    between two neighbours."""
    first_factor: float = Field(1.0, ge=0, allow_inf_nan=False)
    """Factor of the loss at iteration 0, changing linearly to 1. RegNeRF: 400 / 0.1."""
    factor_iterations: int = Field(512, ge=1)
    """Iterations until the factor is 1."""
    by_alpha: bool = False
    """Weight pixels by their alpha, without gradient (RegNeRF on DTU)."""


class DepthSmoothness(Regularizer[DepthSmoothnessSettings]):
    """mean (D[i, j] - D[i, j+1])^2 + (D[i, j] - D[i+1, j])^2, D as blended over sqrt(near far)."""

    host_defaults = HostDefaults(weight=0.1)

    def loss(self, step: Step) -> Tensor:
        """Return the loss at a random camera."""
        camera = virtual_views.draw(self.settings.views, step.scene, self.generator)
        rendering = step.render(camera)
        depth = rendering.depth / math.sqrt(math.prod(step.scene.bounds))
        here = depth[:-1, :-1]
        if not here.numel():  # an image of one row or column
            return depth.sum() * 0
        squares = (here - depth[:-1, 1:]).square() + (here - depth[1:, :-1]).square()
        if self.settings.by_alpha:
            squares = squares * rendering.alpha.detach()[:-1, :-1]
        return self._factor(step.iteration) * squares.mean()

    def _factor(self, iteration: int) -> float:
        progress = min(1.0, iteration / self.settings.factor_iterations)
        return self.settings.first_factor + progress * (1 - self.settings.first_factor)
