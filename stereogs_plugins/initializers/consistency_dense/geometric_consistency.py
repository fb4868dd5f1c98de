"""The geometric consistency filter of StereoGS, which follows MVSNet (Yao et al. 2018).

A pixel of the reference view is lifted to a point, projected into a source view, lifted again with the
source view's depth and projected back. The views are consistent where the reprojection error and the
relative depth error are small. A depth that enough source views confirm is fused with theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from registry.toolkit.progress import in_parallel

from .projection import (
    DepthImage,
    Floats,
    Indices,
    Mask,
    interpolate,
    lift,
    pixel_centers,
    project,
)
from .visibility import source_indices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera


def default_min_consistent(views: int) -> int:
    """Number of source views that must agree: 1 with three views, 2 with four or five, then 3."""
    return min(3, math.ceil((views - 1) / 2))


@dataclass(frozen=True)
class Limits:
    """Limits of the consistency check.

    Args:
        max_reprojection_error: pixels between a pixel and its reprojection.
        max_depth_error: difference between its depth and the reprojected depth, relative to the former.
        min_consistent: number of source views that must agree.
        bounds: (near, far) z-depth of the scene's content, world units; used to choose the source views.
    """

    max_reprojection_error: float
    max_depth_error: float
    min_consistent: int
    bounds: tuple[float, float]


def consistent_depths(
    cameras: Sequence[Camera], depths: Sequence[DepthImage], limits: Limits
) -> list[DepthImage]:
    """For each view the mean of its own and the agreeing depths; 0 where too few source views agree."""
    sources = source_indices(tuple(cameras), limits.bounds)
    return [
        fused_depth(cameras, depths, index, sources[index], limits)[0]
        for index in range(len(cameras))
    ]


def fused_depth(
    cameras: Sequence[Camera],
    depths: Sequence[DepthImage],
    index: int,
    sources: Sequence[int],
    limits: Limits,
) -> tuple[DepthImage, Indices]:
    """Fused depth of one view and the number of agreeing source views; both 0 where too few agree."""
    camera, depth = cameras[index], depths[index]
    u, v = pixel_centers(camera)
    total, votes = depth.astype(np.float64), np.zeros(depth.shape, dtype=np.intp)
    points = lift(camera, u, v, depth)
    for source in sources:
        back_u, back_v, back_z = _reproject(camera, points, cameras[source], depths[source])
        reprojection_error = np.hypot(back_u - u, back_v - v)
        agrees = (depth > 0) & (reprojection_error < limits.max_reprojection_error)
        agrees &= np.abs(back_z - depth) < limits.max_depth_error * depth
        total += np.where(agrees, back_z, 0.0)
        votes += agrees
    enough = votes >= limits.min_consistent
    mean = np.where(enough, total / (1 + votes), 0.0).astype(np.float32)
    return mean, np.where(enough, votes, 0)


def _reproject(
    camera: Camera, points: Floats, source: Camera, source_depth: DepthImage
) -> tuple[Floats, Floats, Floats]:
    """(u, v, z) in `camera` of points moved to the depth that the source view has at their pixels."""
    u, v, _ = project(source, points)
    seen = interpolate(source_depth, u, v)
    known = seen > 0
    moved = lift(source, np.where(known, u, 0.0), np.where(known, v, 0.0), seen)
    back_u, back_v, back_z = project(camera, moved)
    return np.where(known, back_u, np.inf), np.where(known, back_v, np.inf), back_z


@dataclass(frozen=True, eq=False)
class SelectedDepth:
    """Depth of one view, selected per pixel from several priors.

    Args:
        depth: `[H, W]` depth of the selected prior, 0 where unknown.
        confirmed: `[H, W]` its fused depth, 0 where no prior's depth is confirmed.
        prior: `[H, W]` index of the selected prior.
    """

    depth: DepthImage
    confirmed: DepthImage
    prior: Indices


def most_confirmed(
    cameras: Sequence[Camera], depths_by_prior: Sequence[Sequence[DepthImage]], limits: Limits
) -> list[SelectedDepth]:
    """Select per view and pixel the prior whose depth most source views confirm; ties: the first prior.

    A prior is compared only with its own depths of other views. Extends the paper, which uses one prior.

    Args:
        depths_by_prior: for each prior and view, `[H, W]`, 0 where unknown.
    """
    sources = source_indices(tuple(cameras), limits.bounds)

    def select(index: int) -> SelectedDepth:
        fused = [
            fused_depth(cameras, depths, index, sources[index], limits)
            for depths in depths_by_prior
        ]
        prior = np.argmax([votes for _, votes in fused], axis=0)
        return SelectedDepth(
            depth=_take([depths[index] for depths in depths_by_prior], prior),
            confirmed=_take([depth for depth, _ in fused], prior),
            prior=prior,
        )

    return in_parallel(select, range(len(cameras)), stage="points")


def _take(depths: Sequence[DepthImage], prior: Indices) -> DepthImage:
    taken: DepthImage = np.take_along_axis(np.stack(depths), prior[None], axis=0)[0]
    return taken


def without_small_patches(depth: DepthImage, *, min_pixels: int, max_step: float) -> DepthImage:
    """Set depths of connected patches with fewer than `min_pixels` pixels to 0.

    Args:
        max_step: neighbouring pixels are connected if their depths differ by less, relative to the
            nearer one.
    """
    import cv2

    height, width = depth.shape
    # A cell between each two pixels connects them or not, so patches are areas of cells.
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
