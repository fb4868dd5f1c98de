"""Where a view's holes show what other views have confirmed: points stand there already."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..projection import inside, lift, pixel_centers, project

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..projection import Mask
    from ..understanding.contradictions import Evidence

LARGEST_DIFFERENCE = 0.1
"""By how much a channel of the point may lie beyond the colours around its pixel; half of what speaks
against a point, since a point behind what the pixel shows often has nearly its colour."""


def shown_elsewhere(
    asked: Evidence, others: Sequence[Evidence], images: Sequence[NDArray[np.float32]]
) -> Mask:
    """Pixels `[H, W]` into which a confirmed point of another view falls that has their colour.

    Args:
        asked: the view whose pixels are meant.
        others: the views whose points are meant.
        images: the photographs of these, `[H, W, 3]`.
    """
    lowest, highest = asked.lowest - LARGEST_DIFFERENCE, asked.highest + LARGEST_DIFFERENCE
    shown = np.zeros(asked.depth.shape, dtype=np.bool_)
    for other, image in zip(others, images, strict=True):
        known = other.depth > 0
        points = lift(other.camera, *pixel_centers(other.camera), other.depth)[known]
        u, v, z = project(asked.camera, points)
        within = (z > 0) & inside(asked.camera, u, v)
        column, row = u[within].astype(np.intp), v[within].astype(np.intp)
        color = image[known][within]
        alike = ((color >= lowest[row, column]) & (color <= highest[row, column])).all(axis=-1)
        shown[row[alike], column[alike]] = True
    return shown
