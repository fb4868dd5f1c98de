"""Renders of any numbers that the Gaussians have, instead of their colours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from core_rasterizer import SH_C0
from registry.toolkit.views import same_model

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader

CHANNELS = 3


class Painted:
    """Gaussians with numbers in place of colours.

    Args:
        model: the Gaussians; later changes of it are not seen.
        values: `[N, K]`, >= 0.
    """

    def __init__(self, model: GaussianReader, values: Tensor) -> None:
        self.width = values.shape[1]
        gaussians, self._models = model.gaussians(), []
        for first in range(0, self.width, CHANNELS):
            colors = torch.zeros(len(values), CHANNELS)
            part = values[:, first : first + CHANNELS]
            colors[:, : part.shape[1]] = part
            # A colour is max(SH_C0 * sh + 0.5, 0).
            painted = replace(gaussians, sh=((colors - 0.5) / SH_C0)[:, None])
            self._models.append(same_model(model, painted))

    def render(self, camera: Camera) -> Tensor:
        """Return `[H, W, K]`: the sum of the values, each weighted by its share of the pixel's light.

        The weights alpha_i * T_i of a pixel add up to the render's alpha, so they are not normalized.
        """
        with torch.no_grad():
            images = [model.render(camera).rgb for model in self._models]
        return torch.cat(images, dim=2)[..., : self.width]
