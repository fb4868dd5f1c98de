"""Images as tensors: grey levels, sizes, backdrops, PSNR, and what image metrics share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from ..contract.component import Settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from torch import Tensor

__all__ = [
    "MAX_CORRECT_ERROR",
    "ImageMetricSettings",
    "at_size",
    "dark_background",
    "decibels",
    "grey",
    "predicted_psnr",
    "row_bands",
    "white_outside",
]

MAX_CORRECT_ERROR = 0.1
"""Up to this mean difference of its channels from the photograph a pixel is correct; colours in [0, 1]."""
MIN_SQUARED_ERROR = 1e-10
"""Lower bound of the mean squared error: equal images score 100 dB, not infinity."""
_MIN_CONFIDENCE, _MAX_CONFIDENCE = 0.02, 0.9999
_LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in grey (ITU-R BT.601), as in image libraries."""
_BAND = 2**20
"""Pixels in a band. Published protocols use smaller images, whose scores keep their bits."""
_BACKDROP_RUN = 50
"""Pixels to the left of a dark one that must be dark too, to keep dark objects."""


def grey(image: Tensor) -> Tensor:
    """Return the luma `[H, W]` of an image `[H, W, 3]` in [0, 1] (ITU-R BT.601)."""
    return image @ image.new_tensor(_LUMA)


def at_size(pixels: Tensor, height: int, width: int) -> Tensor:
    """Resample a map of a photograph to the size of its render, which samplers may reduce.

    Takes the nearest pixel of a map `[H, W]` or `[H, W, C]` of any type without averaging, so that depths of
    two surfaces and unknown values do not mix. A map of the right size is returned unchanged.
    """
    import torch

    rows, columns = pixels.shape[:2]
    if (rows, columns) == (height, width):
        return pixels
    down = (torch.arange(height) * 2 + 1) * rows // (2 * height)
    right = (torch.arange(width) * 2 + 1) * columns // (2 * width)
    return pixels[down[:, None], right]


def dark_background(image: Tensor, level: int) -> Tensor:
    """Return the black backdrop of DTU's photographs, bool `[H, W]` (DNGaussian, Li et al. 2024).

    A pixel belongs to it if it and the 50 pixels to its left are dark; pixels outside the image count as
    dark.

    Args:
        image: `[H, W, 3]` in [0, 1].
        level: A pixel is dark if its largest channel is below level / 255.
    """
    import torch

    bright = (image.amax(dim=2) >= level / 255).int().cumsum(dim=1)
    before = torch.zeros_like(bright)
    before[:, _BACKDROP_RUN + 1 :] = bright[:, : -(_BACKDROP_RUN + 1)]
    return bright == before


def decibels(squared_error: float | Tensor) -> float:
    """Return the PSNR, at most 100 dB, of a mean squared error; colours in [0, 1]."""
    return -10 * math.log10(max(float(squared_error), MIN_SQUARED_ERROR))


def predicted_psnr(confidence: Tensor) -> float:
    """Return the PSNR in decibels that a confidence predicts, without a photograph.

    A confidence c is read as the probability 1 - exp(-0.1 / m) of an error of at most 0.1, where errors have
    an exponential distribution with mean m and mean square 2 m^2.

    Args:
        confidence: of the pixels, any shape, in [0, 1].
    """
    mean = (
        -MAX_CORRECT_ERROR / (1 - confidence.double().clamp(_MIN_CONFIDENCE, _MAX_CONFIDENCE)).log()
    )
    return decibels((2 * mean.square()).mean())


class ImageMetricSettings(Settings):
    """Settings of metrics that compare two images."""

    quantize: Literal["float", "png8"] = "float"
    """`float` compares colors as they are; `png8` first rounds both images to the 256 levels of a PNG
    file."""

    def prepared(self, image: Tensor) -> Tensor:
        """Convert an image `[H, W, 3]` in [0, 1] for the comparison, to float64."""
        values = image.detach().double()
        if self.quantize == "png8":
            # Rounds half up, as torchvision's `save_image` does in the published code.
            values = (values.clamp(0, 1) * 255 + 0.5).floor() / 255
        return values


def row_bands(height: int, width: int) -> Iterator[slice]:
    """Yield consecutive rows of an image in bands of at most a megapixel.

    A metric that works on one band at a time needs little memory for a photograph of many megapixels.
    """
    rows = max(1, _BAND // width)
    for start in range(0, height, rows):
        yield slice(start, min(start + rows, height))


def white_outside(image: Tensor, mask: Tensor | None) -> Tensor:
    """Set pixels of `[H, W, 3]` outside a mask `[H, W]` bool, if any, to white, as the DTU protocol does."""
    return image if mask is None else image.masked_fill(~mask[..., None], 1.0)
