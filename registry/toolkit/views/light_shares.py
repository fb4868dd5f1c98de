"""Sums over images, weighted by the share of each pixel's light that comes from a Gaussian."""

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
    """Carry images of cameras to the Gaussians: the adjoint of rendering.

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
