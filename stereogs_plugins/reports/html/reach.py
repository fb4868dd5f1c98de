"""The distance from each camera to the subject: what the 3D view turns around."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera, Gaussians

_MIDDLE = 0.6
"""Share of an image's width and height in which Gaussians count."""
_NEARER = 0.4
"""Share of the visible area that is nearer than the subject; below half, because of the background."""
_SURFACE_WEIGHT = 0.1
"""Weight of the depths next to the point where the axes meet, which parallel axes do not have."""
_MAX_CHANGE = 2.0
"""Largest factor between the depth that a camera sees and the distance to the common subject."""
_ALL_GAUSSIANS = 24
"""Cameras up to which all Gaussians count; with more, every second, third ... for time linear in both."""


def reaches(gaussians: Gaussians, cameras: Sequence[Camera]) -> list[float]:
    """Return the distance along each camera's axis to the subject, world units, > 0.

    The subject is near the middle of the images, at a depth that the Gaussians show, and where the axes
    meet if they do.

    Args:
        cameras: at least one.
    """
    step = -(-len(cameras) // _ALL_GAUSSIANS)
    depths = np.array([_depth(gaussians, camera, step) for camera in cameras])
    origins = np.stack([camera.center.double().numpy() for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3].double().numpy() for camera in cameras])
    target = _meeting_point(origins, axes, depths)
    along = np.einsum("nk,nk->n", target - origins, axes)
    return [float(value) for value in np.clip(along, depths / _MAX_CHANGE, depths * _MAX_CHANGE)]


def _depth(gaussians: Gaussians, camera: Camera, step: int) -> float:
    """Return a quantile of the z-depths in the middle of an image, weighted by visible area.

    Args:
        step: between the Gaussians that count.
    """
    means = gaussians.means[::step].double()
    u, v, z = camera.project(means)
    horizontal = (u - camera.width / 2).abs() < _MIDDLE / 2 * camera.width
    vertical = (v - camera.height / 2).abs() < _MIDDLE / 2 * camera.height
    seen = horizontal & vertical & (z > 0)
    if not seen.any():
        return max(float((means - camera.center).norm(dim=1).median()), 1e-6)
    scales = gaussians.log_scales[::step][seen].double().exp().sort(dim=1).values
    areas = gaussians.opacity_logits[::step][seen].double().sigmoid() * scales[:, 1] * scales[:, 2]
    depths, order = z[seen].sort()
    weights = (areas[order] / depths**2).cumsum(dim=0)
    place = int((weights < _NEARER * weights[-1]).sum())
    return float(depths[min(place, len(depths) - 1)])


def _meeting_point(
    origins: NDArray[np.float64], axes: NDArray[np.float64], depths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the point `[3]` nearest to all axes, in least squares, and near the given depths."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    surfaces = origins + depths[:, None] * axes
    matrix = across.sum(axis=0) + _SURFACE_WEIGHT * len(axes) * np.eye(3)
    right = np.einsum("nij,nj->i", across, origins) + _SURFACE_WEIGHT * surfaces.sum(axis=0)
    solved: NDArray[np.float64] = np.linalg.solve(matrix, right)
    return solved
