"""Coarse points behind depth edges, where a moved camera would see a gap behind the foreground.

They lie at the largest depth nearby and have that background's colour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layers import Layer, cell_middles, joined, layer_at

if TYPE_CHECKING:
    from ..projection import Colors, Floats, Indices
    from ..view_depth import ViewDepth

STRIDE = 8
"""Pixels between the points."""
REACHES = (20, 80, 200)
"""Search distances for the background of a foreground pixel, in pixels. The first with a result counts, so
large and thin objects both get their own background."""
SAMPLES = 5
"""Samples between a pixel and the reach, in each direction of both axes."""
QUANTILE = 0.05
"""Quantile of the inverse depths: nearly the farthest, but robust to a single wrong depth."""
GAP = 0.1
"""Least distance between foreground and background, relative to the foreground's depth."""
BACKGROUND_RANGE = 0.1
"""Relative inverse depth above the background's up to which pixels contribute to its colour."""


def back_layer(view: ViewDepth) -> Layer:
    """Points at the background's depth wherever the view's own surface is well in front of it."""
    row, column = cell_middles(view.camera.height, view.camera.width, STRIDE)
    layers = []
    for reach in REACHES:
        own = view.completed[row, column]
        depth, colors = _background(view, row, column, reach)
        found = (own > 0) & (depth > (1 + GAP) * own)
        u, v = column[found] + 0.5, row[found] + 0.5
        layers.append(layer_at(view.camera, u, v, depth[found], colors[found], STRIDE))
        row, column = row[~found], column[~found]
    return joined(layers)


def _background(
    view: ViewDepth, row: Indices, column: Indices, reach: int
) -> tuple[Floats, Colors]:
    """Depth `[P]` and colour `[P, 3]` of the farthest surface near pixels; depth 0 if none is known."""
    image, depth = view.image, view.completed
    height, width = depth.shape
    offsets = np.linspace(-reach, reach, 2 * SAMPLES + 1).round().astype(np.intp)
    down, right = (axis.reshape(-1, 1) for axis in np.meshgrid(offsets, offsets, indexing="ij"))
    r, c = row + down, column + right
    within = (r >= 0) & (r < height) & (c >= 0) & (c < width)
    r, c = r.clip(0, height - 1), c.clip(0, width - 1)
    seen = np.where(within, depth[r, c], 0.0)
    known = seen > 0
    inverse = np.divide(1.0, seen, out=np.full(seen.shape, np.inf), where=known)
    place = (QUANTILE * known.sum(axis=0)).astype(np.intp)
    farthest = np.take_along_axis(np.sort(inverse, axis=0), place[None], axis=0)[0]
    background = known & (inverse <= (1 + BACKGROUND_RANGE) * farthest)
    weights = background * np.exp(-2 * (down**2 + right**2) / reach**2)
    total = (weights[..., None] * image[r, c]).sum(axis=0)
    colors = total / np.maximum(weights.sum(axis=0), 1e-12)[:, None]
    return 1 / farthest, colors.astype(np.float32)
