"""The error of each Gaussian on the training photographs (PRIMU, arXiv 2508.02443: error per primitive)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from registry.toolkit.views import Painted, same_model

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry.confidence import Trained

_LEAST_LIGHT = 1.0
"""Light, in pixels, below which a Gaussian's error is mostly that of all."""


class Residuals:
    """Training errors, carried by the Gaussians to other cameras.

    The gradient of a sum of pixels, weighted by any image, with respect to a Gaussian's colour is the sum of
    that image over the pixels, weighted by the Gaussian's share of their light: one backward pass per view
    gives each Gaussian its light and its mean error.

    Args:
        trained: Gaussians and training views.
    """

    def __init__(self, trained: Trained) -> None:
        model, scene = same_model(trained.model), trained.scene
        model.zero_gradients()
        total = torch.zeros(2)
        for view in scene.train:
            rendering = model.render(view.camera, background=scene.background)
            error = (rendering.rgb.detach().clamp(0, 1) - view.image).abs().mean(dim=2)
            weights = torch.stack([error, torch.ones_like(error), torch.zeros_like(error)], dim=2)
            total += torch.stack([error.sum(), torch.tensor(float(error.numel()))])
            rendering.rgb.backward(weights)
        summed = model.gradient("sh")[:, 0, :2]
        mean = total[0] / total[1]
        light = summed[:, 1].clamp(min=0)
        error = (summed[:, 0].clamp(min=0) + _LEAST_LIGHT * mean) / (light + _LEAST_LIGHT)
        self._painted = Painted(trained.model, torch.stack([error, light / (light + 1)], dim=1))

    def render(self, camera: Camera) -> Tensor:
        """Return `[H, W, 2]`: the Gaussians' errors, and how much light of photographs they have had."""
        return self._painted.render(camera)
