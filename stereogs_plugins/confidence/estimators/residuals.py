"""The error of each Gaussian on the training photographs (PRIMU, arXiv 2508.02443: error per primitive)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from registry.toolkit.views import gathered

from .painted import Painted

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry.confidence import Trained

_MIN_LIGHT = 3.5
"""Light, in pixels, below which a Gaussian's error is mostly that of all."""


class Residuals:
    """Training errors, carried by the Gaussians to other cameras.

    Args:
        trained: Gaussians and training views.
    """

    def __init__(self, trained: Trained) -> None:
        scene = trained.scene
        errors = []
        for view in scene.train:
            rgb = trained.model.render(view.camera, background=scene.background).rgb
            error = (rgb - view.image).abs().mean(dim=2)
            if view.trained is not None:  # excluded pixels tell nothing
                error = error.where(view.trained, error[view.trained].mean())
            errors.append((view.camera, error))
        sums, light = gathered(trained.model, errors)
        mean = torch.cat([error.flatten() for _, error in errors]).mean()
        error = (sums.clamp(min=0) + _MIN_LIGHT * mean) / (light + _MIN_LIGHT)
        self._painted = Painted(trained.model, error[:, None])

    def render(self, camera: Camera) -> Tensor:
        """Return `[H, W]`: the mean error of the Gaussians in each pixel."""
        return self._painted.render(camera)[..., 0]
