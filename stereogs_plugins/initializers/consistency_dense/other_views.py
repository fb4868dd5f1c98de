"""What other views know about points: empty space, the same surface, or nothing.

Each function takes world points `[..., 3]` and some views' cameras and depths, and answers with a mask
`[...]` that is True where it holds for at least one of the views. Depths are 0 where not known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .projection import DepthImage, Floats, Mask, inside, look_up, project

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from core_rasterizer import Camera

FREE_SPACE = 0.05
"""A point hides a surface if it is nearer by more than this, relative to its own depth."""
SAME_SURFACE = 0.02
"""A point lies on a surface if their depths differ by less than this, relative to the point's."""


def hides(points: Floats, cameras: Sequence[Camera], depths: Sequence[DepthImage]) -> Mask:
    """Which points would stand before a surface that a view sees: in space known to be empty."""
    return _any(
        points,
        ((z > 0) & (seen > (1 + FREE_SPACE) * z) for z, seen in _looks(points, cameras, depths)),
    )


def covered(points: Floats, cameras: Sequence[Camera], depths: Sequence[DepthImage]) -> Mask:
    """Which points lie on a surface that a view sees."""
    return _any(
        points,
        (np.abs(seen - z) < SAME_SURFACE * z for z, seen in _looks(points, cameras, depths)),
    )


def overlooked(points: Floats, cameras: Sequence[Camera], depths: Sequence[DepthImage]) -> Mask:
    """Which points lie before or behind a surface that a view sees, or on it."""
    return _any(points, (seen > 0 for _, seen in _looks(points, cameras, depths)))


def in_sight(points: Floats, cameras: Sequence[Camera], depths: Sequence[DepthImage]) -> Mask:
    """Which points lie within a view's image and behind no surface that it sees."""

    def looked_at(camera: Camera, depth: DepthImage) -> Mask:
        u, v, z = project(camera, points)
        seen = look_up(depth, u, v)
        sees: Mask = inside(camera, u, v) & ((seen == 0) | (seen >= z))
        return sees

    return _any(points, map(looked_at, cameras, depths))


def _looks(
    points: Floats, cameras: Sequence[Camera], depths: Sequence[DepthImage]
) -> Iterator[tuple[Floats, Floats]]:
    """For each view the points' depths, and that of the surface seen at their pixels, 0 if none."""
    for camera, depth in zip(cameras, depths, strict=True):
        u, v, z = project(camera, points)
        yield z, look_up(depth, u, v)


def _any(points: Floats, masks: Iterator[Mask]) -> Mask:
    result = np.zeros(points.shape[:-1], dtype=np.bool_)
    for mask in masks:
        result |= mask
    return result
