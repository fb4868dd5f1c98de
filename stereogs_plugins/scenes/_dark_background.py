"""The dark background of DTU photographs, found in the picture itself."""

from __future__ import annotations

import torch
from torch import Tensor

RUN = 50
"""A dark pixel is background if this many pixels to its left are dark too, or all that there are."""


def blacken(image: Tensor, threshold: int) -> Tensor:
    """Set the dark background to black (DNGaussian, Li et al. 2024, and others train on that).

    Args:
        image: `[H, W, 3]` in [0, 1].
        threshold: a pixel is dark if its brightest channel is below this many of 255.
    """
    dark = image.amax(dim=2) < threshold / 255
    bright_so_far = (~dark).cumsum(dim=1)
    before_run = torch.zeros_like(bright_so_far)
    before_run[:, RUN + 1 :] = bright_so_far[:, : -RUN - 1]
    background = bright_so_far == before_run
    return torch.where(background[..., None], torch.zeros(()), image)
