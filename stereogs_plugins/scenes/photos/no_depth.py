"""Pairs of photographs without depth: taken from one position, or of one flat surface.

A homography then explains their matches as well as an epipolar geometry, which COLMAP finds out. Between
photographs from one position it is K R K^-1 with a rotation R and the calibration matrix K (Hartley and
Zisserman 2004, 13.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Doubt = Literal["position", "surface", "pictures"]
"""Why matches of a pair do not connect it: no depth, or the dense check (dense/check.py) failed."""
MIN_DEVIATION = 0.015
"""Least deviation of the singular values of K^-1 H K from 1 if H is not from a rotation."""
MIN_OFF_SURFACE = 0.01
"""Share of matches that agree with the cameras and not with the homography. Pictures without depth had 0.002
at most, neighbouring frames of a video with depth 0.02 to 0.1."""
_FOCALS = np.geomspace(0.7, 1.6, 10)
"""Focal lengths to try, in units of the longer side."""


def has_depth(colmap: Any, geometry: Any) -> bool:
    """False if a homography explains a verified two-view geometry of COLMAP."""
    kinds = colmap.TwoViewGeometryConfiguration
    return geometry.config not in (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)


def doubt_of(colmap: Any, geometry: Any, size: tuple[int, int]) -> Doubt | None:
    """Why a pair's verified geometry contains no depth; None if it does.

    Args:
        geometry: COLMAP's two-view geometry of photographs of one size.
        size: `(width, height)` of the photographs in pixels.
    """
    if has_depth(colmap, geometry) or geometry.H is None:
        return None
    error = rotation_error(np.asarray(geometry.H), size)
    return "position" if error < MIN_DEVIATION else "surface"


def transfer_errors(
    homography: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances `[M]` of points `[M, 2]` of the second picture from those of the first, in pixels."""
    moved = np.column_stack([first, np.ones(len(first))]) @ homography.T
    distances: NDArray[np.float64] = np.linalg.norm(moved[:, :2] / moved[:, 2:] - second, axis=1)
    return distances


def rotation_error(homography: NDArray[np.float64], size: tuple[int, int]) -> float:
    """Return how much a homography `[3, 3]` of pixels differs from the nearest rotation, over all lenses."""
    width, height = size
    errors = []
    for focal in _FOCALS * max(size):
        lens = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        turned = np.linalg.inv(lens) @ homography @ lens
        turned /= np.cbrt(np.linalg.det(turned))
        errors.append(np.abs(np.linalg.svd(turned, compute_uv=False) - 1).max())
    return float(min(errors))
