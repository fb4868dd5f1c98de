"""Geometry of two photographs: do matches agree with their cameras, and do they contain depth?

Matches of photographs from one position, or of one flat surface, have no depth: a homography explains them
as well as an epipolar geometry, which COLMAP finds out. Between photographs from one position it is K R K^-1
with a rotation R and the calibration matrix K (Hartley and Zisserman 2004, 13.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from . import thresholds
from .colmap import lens_of, rays_of

if TYPE_CHECKING:
    from .colmap import Array, Model, VerifiedPair

Doubt = Literal["position", "surface", "pictures"]
"""Why matches of a pair do not connect it: no depth, or the dense check (dense/check.py) failed."""


def sampson_distances(model: Model, pair: tuple[int, int], first: Array, second: Array) -> Array:
    """Sampson distances `[M]` of points `[M, 2]` of two images, in pixels of the first camera.

    Hartley and Zisserman 2004, 11.4.3.
    """
    rays, turn, shift = _motion(model, pair, first, second)
    essential = np.cross(shift, turn, axisb=0, axisc=0)
    lines = [rays[1] @ essential, rays[0] @ essential.T]
    across = (rays[1] * lines[1]).sum(axis=1)
    slope = sum((line[:, :2] ** 2).sum(axis=1) for line in lines)
    distances: Array = lens_of(model, pair[0]).focal_length * np.abs(across) / np.sqrt(slope)
    return distances


def share_in_front(model: Model, pair: tuple[int, int], first: Array, second: Array) -> float:
    """Share of points `[M, 2]` of two images that lie in front of both cameras; 0 without points.

    Sampson distances do not change if one camera moves to the opposite side of the other, behind which the
    points then are.
    """
    rays, turn, shift = _motion(model, pair, first, second)
    turned = rays[0] @ turn.T
    across = np.cross(turned, rays[1])
    depths = -np.cross(shift, rays[1]), -np.cross(shift, turned)
    signs = [(depth * across).sum(axis=1) > 0 for depth in depths]
    return float((signs[0] & signs[1]).sum() / max(1, len(first)))


def _motion(
    model: Model, pair: tuple[int, int], first: Array, second: Array
) -> tuple[list[Array], Array, Array]:
    """Rays `[M, 3]` of points in both cameras, and rotation and translation from the first to the second."""
    lenses = [lens_of(model, image) for image in pair]
    rays = [rays_of(*both) for both in zip(lenses, (first, second), strict=True)]
    poses = [model.image(image).cam_from_world() for image in pair]
    motion = poses[1] * poses[0].inverse()
    return rays, motion.rotation.matrix(), np.asarray(motion.translation)


def transfer_errors(homography: Array, first: Array, second: Array) -> Array:
    """Distances `[M]` of points `[M, 2]` of the second picture from those of the first, in pixels."""
    moved = np.column_stack([first, np.ones(len(first))]) @ homography.T
    distances: Array = np.linalg.norm(moved[:, :2] / moved[:, 2:] - second, axis=1)
    return distances


def doubt_of(pair: VerifiedPair, size: tuple[int, int]) -> Doubt | None:
    """Why a pair's matches contain no depth; None if they do.

    Args:
        size: `(width, height)` of both photographs in pixels.
    """
    homography = pair.homography
    if pair.has_depth or homography is None:
        return None
    return "position" if rotation_error(homography, size) < thresholds.MIN_DEVIATION else "surface"


def rotation_error(homography: Array, size: tuple[int, int]) -> float:
    """Return how much a homography `[3, 3]` of pixels differs from the nearest rotation, over all lenses."""
    width, height = size
    errors = []
    for focal in np.geomspace(*thresholds.TRIED_FOCALS) * max(size):
        lens = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        turned = np.linalg.inv(lens) @ homography @ lens
        turned /= np.cbrt(np.linalg.det(turned))
        errors.append(np.abs(np.linalg.svd(turned, compute_uv=False) - 1).max())
    return float(min(errors))
