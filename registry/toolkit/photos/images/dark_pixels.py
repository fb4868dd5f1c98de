"""The dark background of DTU's photographs, found in the picture itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

RUN = 50
"""Pixels to the left of a dark one that must be dark too, so that dark objects stay."""


def dark_background(image: Tensor, level: int) -> Tensor:
    """Pixels that are dark, with the 50 pixels to their left: DTU's black backdrop, bool `[H, W]`.

    Beyond the image's left border counts as dark. DNGaussian (Li et al. 2024) and others find it so.

    Args:
        image: `[H, W, 3]` in [0, 1].
        level: a pixel is dark if its largest channel is below level / 255.
    """
    import torch

    bright = (image.amax(dim=2) >= level / 255).int().cumsum(dim=1)
    before = torch.zeros_like(bright)
    before[:, RUN + 1 :] = bright[:, : -(RUN + 1)]
    return bright == before
