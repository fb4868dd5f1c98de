"""Which depths of one view the other views confirm (the geometric filter of MVSNet, Yao et al. 2018).

A pixel's point is projected into another view, that view's depth is read there and projected back. Where
pixel and depth come back to nearly the same values, the two views agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..projection import DepthImage, Floats, Mask, interpolate, lift, pixel_centers, project
from ..witnesses import witnesses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera

    Votes = NDArray[np.intp]


def default_min_consistent(views: int) -> int:
    """How many other views must agree: 1 with three views, 2 with four or five, then 3."""
    return min(3, math.ceil((views - 1) / 2))


@dataclass(frozen=True)
class Limits:
    """How well two views' depths must agree.

    Args:
        reprojection: pixels between where a pixel started and where it came back to.
        depth: between its depths then, relative to the first.
        views: how many other views must agree.
        bounds: (near, far) z-depth of the scene's content, world units; the views asked follow from it.
    """

    reprojection: float
    depth: float
    views: int
    bounds: tuple[float, float]


def consistent_depths(
    cameras: Sequence[Camera], depths: Sequence[DepthImage], limits: Limits
) -> list[DepthImage]:
    """For each view the mean of its own depth and of those that confirm it; 0 where too few do.

    Asked are the `witnesses` of each view.
    """
    return [supported(cameras, depths, index, limits)[0] for index in range(len(cameras))]


def supported(
    cameras: Sequence[Camera], depths: Sequence[DepthImage], index: int, limits: Limits
) -> tuple[DepthImage, Votes]:
    """One view's `consistent_depths`, and how many other views confirm each: 0 where too few do."""
    camera, depth = cameras[index], depths[index]
    u, v = pixel_centers(camera)
    total, votes = depth.astype(np.float64), np.zeros(depth.shape, dtype=np.intp)
    points = lift(camera, u, v, depth)
    for other in witnesses(cameras, index, limits.bounds):
        back_u, back_v, back_z = _there_and_back(camera, points, cameras[other], depths[other])
        agrees = (depth > 0) & (np.hypot(back_u - u, back_v - v) < limits.reprojection)
        agrees &= np.abs(back_z - depth) < limits.depth * depth
        total += np.where(agrees, back_z, 0.0)
        votes += agrees
    enough = votes >= limits.views
    mean = np.where(enough, total / (1 + votes), 0.0).astype(np.float32)
    return mean, np.where(enough, votes, 0)


def _there_and_back(
    camera: Camera, points: Floats, other: Camera, other_depth: DepthImage
) -> tuple[Floats, Floats, Floats]:
    """Where points lie in `camera` once `other_depth` has put them to the depth it sees there."""
    u, v, _ = project(other, points)
    seen = interpolate(other_depth, u, v)
    known = seen > 0
    there = lift(other, np.where(known, u, 0.0), np.where(known, v, 0.0), seen)
    back_u, back_v, back_z = project(camera, there)
    return np.where(known, back_u, np.inf), np.where(known, back_v, np.inf), back_z


def without_small_patches(depth: DepthImage, *, min_pixels: int, max_step: float) -> DepthImage:
    """The depths whose surface patch has at least `min_pixels` pixels; others become 0.

    Args:
        max_step: neighbouring pixels belong together if their depths differ by less, relative to the
            nearer one.
    """
    import cv2

    height, width = depth.shape
    # Between two pixels lies a cell that joins them or does not, so that patches are areas of cells.
    cells = np.zeros((2 * height - 1, 2 * width - 1), dtype=np.uint8)
    cells[::2, ::2] = known = depth > 0
    for a, b, between in (
        (depth[:, :-1], depth[:, 1:], cells[::2, 1::2]),
        (depth[:-1], depth[1:], cells[1::2, ::2]),
    ):
        between[:] = (a > 0) & (b > 0) & (np.abs(a - b) < max_step * np.minimum(a, b))
    patches = cv2.connectedComponents(cells, connectivity=4)[1][::2, ::2]
    large: Mask = np.bincount(patches.ravel())[patches] >= min_pixels
    return np.where(known & large, depth, np.float32(0))
