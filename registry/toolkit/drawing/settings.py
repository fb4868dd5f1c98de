"""Settings that image metrics share, and settings that loggers share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import Field

from ...contract.component import Settings
from .pictures import side_by_side, to_bytes

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from core_rasterizer import Rendering


_BAND = 2**20
"""Pixels in a band. Published protocols use smaller images, whose scores keep their bits."""


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


class _Iteration(Protocol):
    """The part of `registry.events.IterationDone` that `LoggerSettings` uses."""

    @property
    def iteration(self) -> int: ...
    @property
    def target(self) -> Tensor: ...
    @property
    def rendering(self) -> Rendering: ...


class LoggerSettings(Settings):
    """Settings of observers that log training images."""

    pictures_every: int = Field(500, ge=0)
    """Iterations between two logged images, which show target and render side by side; the logger must be
    due too (`every`). 0 logs no images."""

    def picture(self, done: _Iteration) -> NDArray[np.uint8] | None:
        """Return target and render side by side, `[H, 2 W + gap, 3]`, if an image is due, else None."""
        if not self.pictures_every or done.iteration % self.pictures_every:
            return None
        return to_bytes(side_by_side(done.target, done.rendering.rgb))
