"""Images brought to a size that a network takes, its answers brought back, maps brought to a render's size.

Sizes are (height, width). A graph may leave a side open, for any multiple of a number, or freeze it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ...errors import PluginError

__all__ = [
    "Fit",
    "FrozenSize",
    "Padding",
    "Size",
    "ValueRange",
    "at_size",
    "full_size_maps",
    "in_range",
    "padded",
    "stretched",
]

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

Size = tuple[int, int]
FrozenSize = tuple[int | None, int | None]
Padding = Literal["replicate", "black"]
ValueRange = Literal["0..255", "0..1", "-1..1", "imagenet"]

_MEAN_AND_DEVIATION = {
    "-1..1": ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
    "imagenet": ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
}


@dataclass(frozen=True)
class Fit:
    """One size's way to another: resized to `content`, then padded evenly on both sides to `target`.

    Args:
        image: the images' size.
        content: what they are resized to.
        target: what the network is given; on no side smaller than `content`.
    """

    image: Size
    content: Size
    target: Size

    @property
    def width_factor(self) -> float:
        """What a distance along a row of the network's answer is multiplied with."""
        return self.image[1] / self.content[1]

    @property
    def height_factor(self) -> float:
        """The same along a column."""
        return self.image[0] / self.content[0]

    def apply(
        self,
        images: Tensor,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        padding: Padding = "replicate",
    ) -> Tensor:
        """`[N, 3, *image]` as `[N, 3, *target]`; what shrinks is smoothed first."""
        from torch.nn.functional import interpolate, pad

        if self.content != self.image:
            shrinks = self.content[0] < self.image[0] or self.content[1] < self.image[1]
            images = interpolate(images, self.content, mode=interpolation, antialias=shrinks)
        if self.target != self.content:
            top, left = self._offset
            bottom = self.target[0] - self.content[0] - top
            right = self.target[1] - self.content[1] - left
            mode = "replicate" if padding == "replicate" else "constant"
            images = pad(images, (left, right, top, bottom), mode=mode)
        return images

    def undo(self, maps: Tensor) -> Tensor:
        """`[N, *target]` as `[N, *image]`, values not rescaled; not finite means unknown and stays so.

        A resized value is the bilinear mean of the known ones around it, known where the nearest is.
        """
        import torch
        from torch.nn.functional import interpolate

        top, left = self._offset
        maps = maps[:, top : top + self.content[0], left : left + self.content[1]]
        if self.content == self.image:
            return maps
        known = torch.isfinite(maps)[:, None]
        values = interpolate(
            torch.where(known[:, 0], maps, 0.0)[:, None], self.image, mode="bilinear"
        )
        weights = interpolate(known.float(), self.image, mode="bilinear")
        nearest = interpolate(known.float(), self.image, mode="nearest-exact") > 0
        return torch.where(nearest, values / weights, torch.nan)[:, 0]

    def undo_points(self, points: Tensor) -> Tensor:
        """Positions `[N, 2]` (column, row) in the target as positions in the image.

        The middle of the first pixel is (0.5, 0.5) in both; what lies in the padding comes out outside.
        """
        top, left = self._offset
        moved = points - points.new_tensor([left, top])
        return moved * points.new_tensor([self.width_factor, self.height_factor])

    @property
    def _offset(self) -> Size:
        """Rows above and columns left of the content; of an odd number the larger half is after it."""
        return (self.target[0] - self.content[0]) // 2, (self.target[1] - self.content[1]) // 2


def padded(image: Size, frozen: FrozenSize, multiple: int) -> Fit:
    """Pad to the frozen size or to the next multiple; an image that is too large is shrunk first.

    Shrinking keeps the proportions: networks were trained on pictures that are not squeezed.
    """
    room = [side if side is not None else math.inf for side in frozen]
    factor = min(1.0, room[0] / image[0], room[1] / image[1])
    content = (max(1, round(image[0] * factor)), max(1, round(image[1] * factor)))
    height, width = (
        side if side is not None else math.ceil(length / multiple) * multiple
        for side, length in zip(frozen, content, strict=True)
    )
    return Fit(image, content, (height, width))


def stretched(image: Size, frozen: FrozenSize, multiple: int) -> Fit:
    """Resize to the frozen size, or to the nearest multiple of each side; nothing is padded."""
    height, width = (
        side if side is not None else max(1, round(length / multiple)) * multiple
        for side, length in zip(frozen, image, strict=True)
    )
    return Fit(image, (height, width), (height, width))


def in_range(images: Tensor, value_range: ValueRange) -> Tensor:
    """Images `[N, 3, H, W]` in [0, 1], clamped and in a network's own numbers.

    `-1..1` is mean 0.5 and deviation 0.5; `imagenet` are the mean and deviation of that data set.
    """
    images = images.clamp(0, 1)  # bicubic resizing overshoots
    if value_range in _MEAN_AND_DEVIATION:
        from kornia.enhance import normalize

        mean, deviation = _MEAN_AND_DEVIATION[value_range]
        return normalize(images, images.new_tensor(mean), images.new_tensor(deviation))
    return images * 255 if value_range == "0..255" else images


def full_size_maps(
    name: str, answers: Mapping[str, Tensor], shape: tuple[int, int, int], where: Path
) -> Tensor:
    """An output as `[N, H, W]`, at the size of the input: the unit of a smaller one is not known.

    Args:
        name: of the output, for the message too.
        shape: (N, H, W); one more side of 1, for the channel, after the first or at the end is taken, too.
        where: the model's file.

    Raises:
        PluginError: the output has another shape.
    """
    count, height, width = shape
    answer = answers[name]
    if tuple(answer.shape) not in ((count, 1, height, width), (count, height, width, 1), shape):
        raise PluginError(
            f"the output {name!r} has the shape {list(answer.shape)}, "
            f"expected [{count}, 1, {height}, {width}]",
            where=str(where),
            fix="export the graph with an output at the size of its images, or name the one that is",
        )
    return answer.reshape(shape)


def at_size(pixels: Tensor, height: int, width: int) -> Tensor:
    """A map of a photograph's pixels at the size of a render of it, which samplers may make smaller.

    Each pixel takes the value of the one that its middle falls into; nothing is averaged, so that depths
    of two surfaces and what is unknown stay apart. A map of that size is returned as it is.

    Args:
        pixels: `[H, W]` of any type.
        height, width: of the render.
    """
    import torch

    rows, columns = pixels.shape
    if (rows, columns) == (height, width):
        return pixels
    down = (torch.arange(height) * 2 + 1) * rows // (2 * height)
    right = (torch.arange(width) * 2 + 1) * columns // (2 * width)
    return pixels[down[:, None], right]
