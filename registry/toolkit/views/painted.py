"""Renders of any numbers that the Gaussians have, instead of their colours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from core_rasterizer import GaussianModel
from core_rasterizer.gaussians import SH_C0

if TYPE_CHECKING:
    from collections.abc import Iterable

    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader, Gaussians

CHANNELS = 3


def same_model(model: GaussianReader, gaussians: Gaussians | None = None) -> GaussianModel:
    """Return a copy of Gaussians that can be differentiated, without changing those of a run.

    Args:
        gaussians: these instead, rendered like the model's.
    """
    return GaussianModel(
        gaussians or model.gaussians(),
        model.device,
        dilation=model.dilation,
        compensate_dilation=model.compensate_dilation,
    )


def gathered(
    model: GaussianReader, images: Iterable[tuple[Camera, Tensor]]
) -> tuple[Tensor, Tensor]:
    """Carry images of cameras to the Gaussians: the inverse of painting.

    The derivative of a pixel by a Gaussian's colour is its share of the pixel's light, so that one backward
    pass for each camera weights an image by these shares and sums it over the pixels.

    Args:
        images: cameras, each with `[H, W]` of its size.

    Returns:
        Two tensors `[N]`: the weighted sums, and the sums of the weights, in pixels.
    """
    gaussians = model.gaussians()
    # Not black: colours are clamped at 0, where their derivative is 0.
    grey = replace(gaussians, sh=torch.zeros(len(gaussians), 1, 3))
    copy = same_model(model, grey)
    copy.zero_gradients()
    for camera, image in images:
        weights = torch.stack([image, torch.ones_like(image), torch.zeros_like(image)], dim=2)
        copy.render(camera).rgb.backward(weights)
    sums, light, _ = (copy.gradient("sh")[:, 0] / SH_C0).unbind(dim=1)
    return sums, light.clamp(min=0)


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
