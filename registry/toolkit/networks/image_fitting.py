"""Resize images to a network's input size and its outputs back; resize maps to a render's size.

    fit = padded((height, width), (None, None), multiple=32)
    depth = fit.undo(network(in_range(fit.apply(images), "imagenet")))

Shapes are (height, width). Each side of a graph's input is fixed, or dynamic (None) with a divisor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ...contract.scene import DepthMap
from ...errors import PluginError

__all__ = [
    "Fit",
    "FrozenShape",
    "Padding",
    "ValueRange",
    "contained",
    "depth_map",
    "full_size_maps",
    "in_range",
    "padded",
    "stretched",
]

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

Shape = tuple[int, int]
"""`(height, width)`, as in shapes of tensors; a `Size` of `registry.toolkit.photos` is (width, height)."""
FrozenShape = tuple[int | None, int | None]
"""Shape of a graph's input; None for a side that is dynamic."""
Padding = Literal["replicate", "black", "white", "mean"]
"""What surrounds an image: its border, or a colour; `mean` is that of ImageNet."""
ValueRange = Literal["0..255", "0..1", "-1..1", "imagenet"]

_MEAN = (0.485, 0.456, 0.406)
_MEAN_AND_DEVIATION = {
    "-1..1": ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
    "imagenet": (_MEAN, (0.229, 0.224, 0.225)),
}
_COLORS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0), "mean": _MEAN}


@dataclass(frozen=True)
class Fit:
    """A transform that resizes images to `content`, then pads both sides evenly to `target`.

    Args:
        image, content, target: shapes of the images, after resizing, and of the network's input.
    """

    image: Shape
    content: Shape
    target: Shape

    @property
    def width_factor(self) -> float:
        """Factor from horizontal distances in the network's output to distances in the image."""
        return self.image[1] / self.content[1]

    @property
    def height_factor(self) -> float:
        """Factor for vertical distances."""
        return self.image[0] / self.content[0]

    def apply(
        self,
        images: Tensor,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        padding: Padding = "replicate",
    ) -> Tensor:
        """Convert `[N, 3, *image]` to `[N, 3, *target]`; downsampling uses an anti-aliasing filter."""
        from torch.nn.functional import interpolate, pad

        if self.content != self.image:
            shrinks = self.content[0] < self.image[0] or self.content[1] < self.image[1]
            images = interpolate(images, self.content, mode=interpolation, antialias=shrinks)
        if self.target != self.content:
            top, left = self._offset
            bottom = self.target[0] - self.content[0] - top
            right = self.target[1] - self.content[1] - left
            border = (left, right, top, bottom)
            if padding == "replicate":
                return pad(images, border, mode="replicate")
            color = images.new_tensor(_COLORS[padding])[:, None, None]
            images = pad(images - color, border) + color
        return images

    def undo(self, maps: Tensor) -> Tensor:
        """Convert `[N, *target]` to `[N, *image]` without scaling values; non-finite values mean unknown.

        A resized value is the bilinear mean of the known neighbors; it is unknown if the nearest is.
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
        """Convert positions `[N, 2]` (column, row) in the target to positions in the image.

        The center of the first pixel is (0.5, 0.5) in both. Positions in the padding end up outside.
        """
        top, left = self._offset
        moved = points - points.new_tensor([left, top])
        return moved * points.new_tensor([self.width_factor, self.height_factor])

    def undo_intrinsics(self, intrinsics: Tensor) -> Tensor:
        """Convert intrinsics `[3, 3]` in pixels of the target to pixels of the image."""
        changed = intrinsics.clone()
        changed[0] *= self.width_factor
        changed[1] *= self.height_factor
        changed[:2, 2] = self.undo_points(intrinsics[None, :2, 2])[0]
        return changed

    @property
    def _offset(self) -> Shape:
        """Padding above and left of the content; of an odd padding, the larger half follows the content."""
        return (self.target[0] - self.content[0]) // 2, (self.target[1] - self.content[1]) // 2


def padded(image: Shape, frozen: FrozenShape, multiple: int) -> Fit:
    """Pad to the fixed size or the next multiple; downsample larger images first, keeping proportions."""
    room = [side if side is not None else math.inf for side in frozen]
    factor = min(1.0, room[0] / image[0], room[1] / image[1])
    content = (max(1, round(image[0] * factor)), max(1, round(image[1] * factor)))
    height, width = (
        side if side is not None else math.ceil(length / multiple) * multiple
        for side, length in zip(frozen, content, strict=True)
    )
    return Fit(image, content, (height, width))


def contained(image: Shape, target: Shape) -> Fit:
    """Resize to the largest size that fits into the target with the same proportions, and pad."""
    factor = min(target[0] / image[0], target[1] / image[1])
    content = (max(1, round(image[0] * factor)), max(1, round(image[1] * factor)))
    return Fit(image, content, target)


def stretched(image: Shape, frozen: FrozenShape, multiple: int) -> Fit:
    """Resize to the fixed size, or each side to the nearest multiple, without padding."""
    height, width = (
        side if side is not None else max(1, round(length / multiple)) * multiple
        for side, length in zip(frozen, image, strict=True)
    )
    return Fit(image, (height, width), (height, width))


def in_range(images: Tensor, value_range: ValueRange) -> Tensor:
    """Clamp images `[N, 3, H, W]` to [0, 1] and convert them to a network's range.

    `imagenet` subtracts the mean of that data set and divides by its standard deviation.
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
    """Return an output as `[N, H, W]`; refuse other sizes, whose unit would be ambiguous.

    Args:
        name, answers: Name of the output, and all outputs by name.
        shape: (N, H, W); the output may have an additional channel dimension of 1, second or last.
        where: Path of the model's file.

    Raises:
        PluginError: The output has another shape.
    """
    count, height, width = shape
    answer = answers[name]
    if tuple(answer.shape) not in ((count, 1, height, width), (count, height, width, 1), shape):
        raise PluginError(
            f"the output {name!r} has the shape {list(answer.shape)}, "
            f"expected [{count}, 1, {height}, {width}]",
            where=str(where),
            fix="export the graph with an output at the size of its images, or choose such an output",
        )
    return answer.reshape(shape)


def depth_map(
    depth: str,
    confidence: str | None,
    answers: Mapping[str, Tensor],
    fit: Fit,
    where: Path,
    min_confidence: float,
) -> DepthMap:
    """Return the depth of one image at its own size, from outputs at the size of the network.

    Args:
        depth, confidence: Names of the outputs; without confidence it is 1.
        answers: All outputs by name.
        where: Path of the model's file.
        min_confidence: Depths with a lower confidence are invalid, as are those <= 0 or not finite.

    Raises:
        PluginError: An output has another shape than the network's images.
    """
    import torch

    shape = (1, *fit.target)
    found = full_size_maps(depth, answers, shape, where)
    known, trust = found > 0, torch.ones_like(found)
    if confidence is not None and confidence in answers:
        trust = full_size_maps(confidence, answers, shape, where)
        known &= trust >= min_confidence
    values = fit.undo(torch.where(known, found, torch.nan))[0]
    valid = torch.isfinite(values)
    trust = torch.where(valid, fit.undo(trust)[0], 0.0)
    return DepthMap(torch.where(valid, values, 0.0), valid, trust)
