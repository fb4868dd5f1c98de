"""Coarse points behind depth edges: what a camera beside the training camera sees there first.

They stand at the largest depth nearby and have that background's colour. Without them a moved camera
looks through the gap between foreground and background into nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layers import Layer, cell_middles, joined, layer_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..projection import Floats, Indices
    from ..view_depth import ViewDepth

STRIDE = 8
"""Pixels between the points."""
REACHES = (20, 80, 200)
"""Pixels; how far from a foreground pixel its background is looked for. The first find counts, so that
a large object has a background too, and a thin one its own."""
SAMPLES = 5
"""How many places are looked at between a pixel and the reach, in each direction of both axes."""
QUANTILE = 0.05
"""Of the inverse depths there: nearly the farthest, yet no single wrong depth decides."""
GAP = 0.1
"""The background must be farther than the foreground by so much, relative to the foreground."""
BACKGROUND_RANGE = 0.1
"""What is nearer than the background by up to so much still lends it its colour."""


def back_layer(view: ViewDepth) -> Layer:
    """Points at the background's depth wherever the view's own surface is well before it."""
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
) -> tuple[Floats, NDArray[np.float32]]:
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
    nearness = np.divide(1.0, seen, out=np.full(seen.shape, np.inf), where=known)
    place = (QUANTILE * known.sum(axis=0)).astype(np.intp)
    farthest = np.take_along_axis(np.sort(nearness, axis=0), place[None], axis=0)[0]
    background = known & (nearness <= (1 + BACKGROUND_RANGE) * farthest)
    weights = background * np.exp(-2 * (down**2 + right**2) / reach**2)
    total = (weights[..., None] * image[r, c]).sum(axis=0)
    colors = total / np.maximum(weights.sum(axis=0), 1e-12)[:, None]
    return 1 / farthest, colors.astype(np.float32)
