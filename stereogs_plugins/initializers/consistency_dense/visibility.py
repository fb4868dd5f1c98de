"""Tests of points against the depth maps of other views.

Each test takes world points `[..., 3]` and (camera, depth) of some views, and returns a mask `[...]` that is
True where the test holds for at least one view. Depths are 0 where unknown.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from core_rasterizer.matching import source_views

from .projection import DepthImage, Floats, Mask, inside, look_up, project

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from core_rasterizer import Camera

    Views = Iterable[tuple[Camera, DepthImage]]

View = TypeVar("View")
MAX_SOURCES = 8
"""Source views per view; more cost time and confirm hardly more."""
MOST_VIEWS = 48
"""Views that a test of all points looks into; all would take time quadratic in the views."""
FREE_SPACE = 0.05
"""A point is in free space if a surface behind it is farther by more than this, relative to the point."""
SAME_SURFACE = 0.02
"""A point is on a surface if their depths differ by less than this, relative to the point's."""


@lru_cache(maxsize=1)
def source_indices(
    cameras: tuple[Camera, ...], bounds: tuple[float, float]
) -> tuple[tuple[int, ...], ...]:
    """For each view the sorted indices of its source views, chosen by triangulation angle and overlap.

    The answer is kept: each step of the initializer asks for the same lists.

    Args:
        bounds: (near, far) z-depth of the scene's content, world units.
    """
    return tuple(tuple(sorted(found)) for found in source_views(cameras, MAX_SOURCES, bounds))


def spread(views: Sequence[View], most: int | None = MOST_VIEWS) -> tuple[View, ...]:
    """At most `most` views, evenly spread over the given order; None: all."""
    count = min(most or len(views), len(views))
    return tuple(views[number * len(views) // count] for number in range(count))


def in_free_space(points: Floats, views: Views) -> Mask:
    """Points in front of a surface that a view sees, which they would hide."""
    return _any(
        points,
        ((z > 0) & (seen > (1 + FREE_SPACE) * z) for z, seen in _depths(points, views)),
    )


def on_surface(points: Floats, views: Views) -> Mask:
    """Points on a surface that a view sees."""
    return _any(
        points,
        (np.abs(seen - z) < SAME_SURFACE * z for z, seen in _depths(points, views)),
    )


def onto_known_depth(points: Floats, views: Views) -> Mask:
    """Points that project onto a pixel whose depth is known."""
    return _any(points, (seen > 0 for _, seen in _depths(points, views)))


def visible(points: Floats, views: Views) -> Mask:
    """Points inside a view's image and not behind the surface that it sees there."""

    def sees(camera: Camera, depth: DepthImage) -> Mask:
        u, v, z = project(camera, points)
        seen = look_up(depth, u, v)
        result: Mask = inside(depth.shape, u, v) & ((seen == 0) | (seen >= z))
        return result

    return _any(points, (sees(*view) for view in views))


def _depths(points: Floats, views: Views) -> Iterator[tuple[Floats, Floats]]:
    """For each view the points' depths and the depths of the pixels that they project onto."""
    for camera, depth in views:
        u, v, z = project(camera, points)
        yield z, look_up(depth, u, v)


def _any(points: Floats, masks: Iterator[Mask]) -> Mask:
    result = np.zeros(points.shape[:-1], dtype=np.bool_)
    for mask in masks:
        result |= mask
    return result
