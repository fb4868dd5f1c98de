"""`depth_smoothness`: depth seen from where no photograph was taken is smooth (RegNeRF on Gaussians).

Niemeyer et al., CVPR 2022. RegNeRF renders a few patches of 8 by 8 pixels; Gaussians give
the whole picture at once, so that every pixel and its neighbours count.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

if TYPE_CHECKING:
    from torch import Tensor


class DepthSmoothnessSettings(Settings):
    views: VirtualViewKind = "box"
    """Where the virtual camera of each iteration stands: in a box or on a sphere around the training
    cameras, or between two neighbours."""
    first_factor: float = Field(1.0, ge=0, allow_inf_nan=False)
    """What the term is multiplied by at iteration 0; from there linearly to 1. RegNeRF: 400 / 0.1."""
    factor_iterations: int = Field(512, ge=1)
    """Iterations until the factor is 1."""
    by_alpha: bool = False
    """Weigh pixels by their alpha, through which no gradient flows (RegNeRF on DTU)."""


class DepthSmoothness(Regularizer[DepthSmoothnessSettings]):
    """mean (D[i, j] - D[i, j+1])^2 + (D[i, j] - D[i+1, j])^2, D as blended over sqrt(near far)."""

    def loss(self, step: Step) -> Tensor:
        """The term at a camera drawn for this iteration."""
        camera = virtual_views.draw(self.settings.views, step.scene, self.generator)
        rendering = step.render(camera)
        depth = rendering.depth / math.sqrt(math.prod(step.scene.bounds))
        here = depth[:-1, :-1]
        if not here.numel():  # an image of one row or column has no neighbours
            return depth.sum() * 0
        squares = (here - depth[:-1, 1:]).square() + (here - depth[1:, :-1]).square()
        if self.settings.by_alpha:
            squares = squares * rendering.alpha.detach()[:-1, :-1]
        return self._factor(step.iteration) * squares.mean()

    def _factor(self, iteration: int) -> float:
        progress = min(1.0, iteration / self.settings.factor_iterations)
        return self.settings.first_factor + progress * (1 - self.settings.first_factor)
