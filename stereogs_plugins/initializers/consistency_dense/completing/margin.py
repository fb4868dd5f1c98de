"""A ring of coarse points around each image, so that nothing ends at the edge of a photograph.

They carry the blurred colour of the nearest image border and lie at the background's depth there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..image_filters import blurred
from ..layers import Layer, layer_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..projection import Floats
    from ..view_depth import ViewDepth

WIDTH = 0.5
"""Of the ring, as a part of the image's width and height."""
STRIDE = 10
"""Pixels between the points."""
BLUR = 15.0
"""Pixels; standard deviation of the blur of the colours."""
PERCENTILE = 10
"""Of the inverse depths around a point, the image's nearest pixel standing for what is outside."""
WINDOW = 15
"""So many points in a row make up a point's surroundings."""


def margin(view: ViewDepth) -> Layer:
    """Points outside the image, none where the border nearby has no depth."""
    height, width = view.completed.shape
    u, v = np.meshgrid(_positions(width), _positions(height))
    outside = (u < 0) | (u >= width) | (v < 0) | (v >= height)
    row, column = v.clip(0, height - 1).astype(np.intp), u.clip(0, width - 1).astype(np.intp)
    seen = view.completed[row, column].astype(np.float64)
    # Unknown depths count as near, so that the low percentile passes over them.
    nearness = np.divide(1.0, seen, out=np.full(seen.shape, np.inf), where=seen > 0)
    background = _low_percentile(nearness)
    keep = outside & np.isfinite(background)
    colors = blurred(view.image, BLUR, outside="border")[row[keep], column[keep]]
    return layer_at(view.camera, u[keep], v[keep], 1 / background[keep], colors, STRIDE)


def _low_percentile(nearness: Floats) -> Floats:
    """Of the values around each of `[R, C]`, the border going on outside."""
    if not nearness.size:  # of a picture too small for a ring
        return nearness
    padded = np.pad(nearness, WINDOW // 2, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (WINDOW, WINDOW))
    around = around.reshape(*nearness.shape, WINDOW**2)
    place = PERCENTILE * WINDOW**2 // 100
    low: Floats = np.partition(around, place, axis=-1)[..., place]
    return low


def _positions(size: int) -> NDArray[np.float64]:
    """Pixel positions along one axis, from before the image to behind it."""
    reach = WIDTH * size
    return np.arange(-reach + STRIDE / 2, size + reach, STRIDE)
