"""A ring of coarse points around each image, so that the scene does not end at a photograph's border.

They have the blurred colour of the nearest border pixel and lie at the background's depth there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..image_filters import blurred
from ..layers import Layer, layer_at
from ..projection import inside

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..projection import Floats
    from ..view_depth import ViewDepth

WIDTH = 0.5
"""Width of the ring relative to the image's width and height."""
STRIDE = 10
"""Pixels between the points."""
BLUR = 15.0
"""Standard deviation of the blur of the colours, pixels."""
PERCENTILE = 10
"""Percentile of the inverse depths around a point; positions outside take the nearest border pixel's."""
WINDOW = 15
"""Width of that neighbourhood, in points."""


def margin(view: ViewDepth) -> Layer:
    """Points outside the image, except where the border nearby has no depth."""
    height, width = view.completed.shape
    u, v = np.meshgrid(_positions(width), _positions(height))
    row, column = v.clip(0, height - 1).astype(np.intp), u.clip(0, width - 1).astype(np.intp)
    seen = view.completed[row, column].astype(np.float64)
    # Unknown depths count as near, so that the low percentile skips them.
    inverse = np.divide(1.0, seen, out=np.full(seen.shape, np.inf), where=seen > 0)
    background = _low_percentile(inverse)
    keep = ~inside(view.completed.shape, u, v) & np.isfinite(background)
    colors = blurred(view.image, BLUR, outside="border")[row[keep], column[keep]]
    return layer_at(view.camera, u[keep], v[keep], 1 / background[keep], colors, STRIDE)


def _low_percentile(values: Floats) -> Floats:
    """The percentile around each of `[R, C]`, with a repeated border."""
    if not values.size:  # the image is too small for a ring
        return values
    padded = np.pad(values, WINDOW // 2, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (WINDOW, WINDOW))
    around = around.reshape(*values.shape, WINDOW**2)
    place = PERCENTILE * WINDOW**2 // 100
    low: Floats = np.partition(around, place, axis=-1)[..., place]
    return low


def _positions(size: int) -> NDArray[np.float64]:
    """Pixel positions along one axis, including the ring on both sides."""
    reach = WIDTH * size
    return np.arange(-reach + STRIDE / 2, size + reach, STRIDE)
