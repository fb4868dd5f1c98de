"""The numbers that networks take for black and white."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from torch import Tensor

ValueRange = Literal["0..255", "0..1", "-1..1", "imagenet"]

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_DEVIATION = (0.229, 0.224, 0.225)


def in_range(images: Tensor, value_range: ValueRange) -> Tensor:
    """Images `[N, 3, H, W]` in [0, 1], clamped and in a network's own numbers.

    `-1..1` is mean 0.5 and deviation 0.5; `imagenet` are the mean and deviation of that data set.
    """
    images = images.clamp(0, 1)  # bicubic resizing overshoots
    if value_range == "0..255":
        return images * 255
    if value_range == "-1..1":
        return images * 2 - 1
    if value_range == "imagenet":
        mean = images.new_tensor(_IMAGENET_MEAN)[:, None, None]
        return (images - mean) / images.new_tensor(_IMAGENET_DEVIATION)[:, None, None]
    return images
