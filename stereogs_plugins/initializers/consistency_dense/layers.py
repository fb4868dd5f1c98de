"""Points lifted from one view, with colours and spacings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .projection import Colors, Floats, Indices, Mask, lift

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

    from .view_depth import ViewDepth

SAME_SURFACE = 0.05
"""Relative depth difference up to which pixels of one cell belong to one surface."""


@dataclass(frozen=True, eq=False)
class Layer:
    """P points of one kind.

    Args:
        positions: `[P, 3]` world units.
        colors: `[P, 3]` float32 in [0, 1].
        spacings: `[P]` world units, distance of points that are neighbours in the image.
    """

    positions: Floats
    colors: Colors
    spacings: Floats

    def __len__(self) -> int:
        return len(self.positions)

    def without(self, dropped: Mask) -> Layer:
        """The points where `dropped` `[P]` is False."""
        return Layer(self.positions[~dropped], self.colors[~dropped], self.spacings[~dropped])


def is_background(colors: Colors, background: Sequence[float], levels: int) -> Mask:
    """Colours `[..., 3]` equal to the scene's background, which is drawn where no Gaussian is.

    A guessed point of that colour adds nothing and may hide what other views see.

    Args:
        levels: of 255; each channel must differ by less.
    """
    background_color = np.asarray(background, np.float32)
    result: Mask = (np.abs(colors - background_color) < levels / 255).all(axis=-1)
    return result


def joined(layers: Sequence[Layer]) -> Layer:
    """All points of one or more layers, in order."""
    return Layer(
        np.concatenate([layer.positions for layer in layers]),
        np.concatenate([layer.colors for layer in layers]),
        np.concatenate([layer.spacings for layer in layers]),
    )


def layer_at(
    camera: Camera, u: Floats, v: Floats, depth: Floats, colors: Colors, pixels: float
) -> Layer:
    """Points at pixel positions and depths `[P]`, `pixels` apart in the image."""
    spacings = pixels * depth / (0.5 * (camera.fx + camera.fy))
    return Layer(lift(camera, u, v, depth), colors, spacings)


def cell_middles(height: int, width: int, stride: int) -> tuple[Indices, Indices]:
    """Rows and columns `[P]` of the middle pixels of all stride x stride cells."""
    row, column = np.meshgrid(
        np.arange(stride // 2, height, stride), np.arange(stride // 2, width, stride), indexing="ij"
    )
    return row.ravel(), column.ravel()


def surface(view: ViewDepth, wanted: Mask, stride: int) -> Layer:
    """One point per stride x stride cell whose middle pixel is wanted and has a depth.

    Its colour is the mean of the cell's pixels on the same surface.
    """
    image, depth = view.image, view.completed
    height, width = depth.shape
    row, column = cell_middles(height, width, stride)
    chosen = (depth[row, column] > 0) & wanted[row, column]
    row, column = row[chosen], column[chosen]
    middle = depth[row, column].astype(np.float64)
    total, count = np.zeros((len(row), 3)), np.zeros((len(row), 1))
    first = -(stride // 2)
    for down in range(first, first + stride):
        for right in range(first, first + stride):
            r, c = (row + down).clip(0, height - 1), (column + right).clip(0, width - 1)
            same = (np.abs(depth[r, c] - middle) < SAME_SURFACE * middle)[:, None]
            total += same * image[r, c]
            count += same
    colors = (total / count).astype(np.float32)
    return layer_at(view.camera, column + 0.5, row + 0.5, middle, colors, stride)
