"""The point that cameras look at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera


def nearest_to_axes(cameras: Sequence[Camera], min_eigenvalue: float) -> NDArray[np.float64] | None:
    """Return the point with the smallest sum of squared distances to all optical axes, `[3]`, world units.

    Args:
        cameras: at least one.
        min_eigenvalue: smallest eigenvalue of the mean of I - d d^T over the axes' directions d. It is near
            0 for parallel axes: 1e-6 for axes within a milliradian, 1e-3 within 2 degrees.

    Returns:
        None if the axes are nearly parallel, or the point is not in front of all cameras.
    """
    centers, axes = lines_of_sight(cameras)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # [V, 3, 3]
    together = across.mean(axis=0)
    if np.linalg.eigvalsh(together)[0] <= min_eigenvalue:
        return None
    point = np.linalg.solve(together, np.einsum("vij,vj->i", across, centers) / len(centers))
    return point if np.einsum("vi,vi->v", axes, point - centers).min() > 0 else None


def lines_of_sight(cameras: Sequence[Camera]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centers and the directions of the optical axes, `[V, 3]` each."""
    centers = np.stack([camera.center.numpy() for camera in cameras])
    return centers, np.stack([camera.world_to_camera[2, :3].numpy() for camera in cameras])
