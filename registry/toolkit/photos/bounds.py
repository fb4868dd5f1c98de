"""Estimate depth bounds for scenes whose files contain none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from core_rasterizer import Camera

    from ...contract.scene import PointCloud

Bounds = tuple[float, float]

MIN_POINTS = 8
"""Visible points that an image needs to contribute."""
PERCENTILES = (0.1, 99.9)
MARGIN = 1.1
"""Factor that widens bounds from points: points are sparse and rarely cover the extremes."""
FOCUS_FACTOR = 5.0
"""Content is assumed from 1/5 to 5 times the distance of the point that the cameras look at."""
_MIN_EIGENVALUE = 1e-3
"""Of `nearest_to_axes`; axes within about 2 degrees count as parallel."""
SAME_CENTER = 1e-12
"""Centres nearer to each other than this, relative to their coordinates, differ by rounding only."""
BASELINES = (1.0, 100.0)
"""Bounds of cameras with parallel axes, in units of the largest distance between two cameras."""


def estimate_bounds(cameras: Sequence[Camera], points: PointCloud | None, where: str) -> Bounds:
    """Return (near, far) z-depth, from the first of these that applies to the training cameras:

    1. Points: the 0.1 and 99.9 percentiles of their depths in each image, the extremes over all images,
       widened by 10 %.
    2. The point nearest to all optical axes, if it lies in front of all cameras and the axes are not
       almost parallel: from 1/5 of its smallest depth to 5 times its largest.
    3. The largest distance between two cameras: from 1 to 100 times that.

    Raises:
        SceneError: The scene has no points and all cameras have the same center.
    """
    bounds = _from_points(cameras, points) or _from_focus(cameras) or _from_baselines(cameras)
    if bounds is None:
        raise SceneError(
            "the scene's depth is unknown: it has no points, and the training cameras have the same "
            "center",
            where=where,
            fix="use two or more training views, or add points",
        )
    return bounds


def object_bounds(cameras: Sequence[Camera], where: str) -> Bounds:
    """Return (near, far) z-depth for cameras around an object: 1/2 and 3/2 of their distance to it.

    The object is at the point nearest to all optical axes; `estimate_bounds` if there is none.

    Raises:
        SceneError: as `estimate_bounds`.
    """
    depths = _depths_of_focus(cameras)
    if depths is None:
        return estimate_bounds(cameras, None, where)
    return 0.5 * float(depths.mean()), 1.5 * float(depths.mean())


def _from_points(cameras: Sequence[Camera], points: PointCloud | None) -> Bounds | None:
    import numpy as np
    import torch

    if points is None:
        return None
    extremes = []
    for camera in cameras:
        column, row, depth = camera.project(points.positions)
        inside = camera.contains(column, row, depth, border=True)
        visible = depth[inside & torch.isfinite(depth)].numpy()
        if len(visible) >= MIN_POINTS:
            extremes.append(np.percentile(visible, PERCENTILES))
    if not extremes:
        return None
    nearest, farthest = np.min(extremes, axis=0)[0], np.max(extremes, axis=0)[1]
    return float(nearest / MARGIN), float(farthest * MARGIN)


def _from_focus(cameras: Sequence[Camera]) -> Bounds | None:
    depths = _depths_of_focus(cameras)
    if depths is None:
        return None
    return float(depths.min() / FOCUS_FACTOR), float(depths.max() * FOCUS_FACTOR)


def _depths_of_focus(cameras: Sequence[Camera]) -> NDArray[np.float64] | None:
    """Return the z-depth in each camera of the point nearest to all optical axes, if there is one."""
    import numpy as np

    from .focus import lines_of_sight, nearest_to_axes

    focus = nearest_to_axes(cameras, _MIN_EIGENVALUE)
    if focus is None:
        return None
    centers, axes = lines_of_sight(cameras)
    depths: NDArray[np.float64] = np.einsum("vi,vi->v", axes, focus - centers)
    return depths


def _from_baselines(cameras: Sequence[Camera]) -> Bounds | None:
    import numpy as np

    centers = np.stack([camera.center.numpy() for camera in cameras])
    largest = float(np.linalg.norm(centers[:, None] - centers[None], axis=2).max())
    if largest <= SAME_CENTER * max(1.0, float(np.abs(centers).max())):
        return None
    return BASELINES[0] * largest, BASELINES[1] * largest
