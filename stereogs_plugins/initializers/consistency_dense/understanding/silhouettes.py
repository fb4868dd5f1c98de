"""Silhouettes: where a view shows plain background, nothing stands before it.

What all silhouettes leave is the visual hull (Laurentini 1994).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..projection import Floats, Mask, inside, project

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

SAFETY = 0.01
"""Width of the strip along silhouettes that is not believed, as a part of the image's longer side."""


def safely_inside(background: Mask) -> Mask:
    """The pixels of plain background that stand well away from anything else.

    Also away from the image border, where the photograph does not tell what is beside it.
    """
    import cv2

    if not background.any():
        return background
    padded = np.pad(background, 1).view(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    safe: Mask = distance > 1 + SAFETY * max(background.shape)
    return safe


def outside_votes(
    points: Floats, cameras: Sequence[Camera], backgrounds: Sequence[Mask]
) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """How many views show safe plain background where each world point `[P, 3]` would be seen."""
    votes = np.zeros(len(points), dtype=np.intp)
    for camera, background in zip(cameras, backgrounds, strict=True):
        u, v, _ = project(camera, points)
        within = inside(camera, u, v)
        column, row = np.where(within, u, 0).astype(np.intp), np.where(within, v, 0).astype(np.intp)
        votes += within & background[row, column]
    return votes
