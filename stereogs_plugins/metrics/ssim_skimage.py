"""`ssim_skimage`: structural similarity with scikit-image's defaults, as the NeRF literature measures it.

A uniform 7x7 window, sample covariance, mean over the image without a border of 3 pixels.
"""

from __future__ import annotations

import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from registry import Metric, Register, Settings, hookimpl


class ScikitImageSSIM(Metric[Settings]):
    """With a mask, both images are white outside it, and all pixels count (the DTU protocol)."""

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        """Return the similarity, at most 1. The images must be at least 7x7."""
        first, second = rendered, photograph
        if mask is not None:
            white = torch.ones_like(photograph)
            first = first.where(mask[..., None], white)
            second = second.where(mask[..., None], white)
        score = structural_similarity(
            first.double().numpy(), second.double().numpy(), data_range=1.0, channel_axis=2
        )
        return float(score)


@hookimpl
def stereogs_register_metrics(register: Register[ScikitImageSSIM]) -> None:
    register("ssim_skimage", ScikitImageSSIM)
