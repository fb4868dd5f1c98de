"""Pixels to world points and back, for whole depth maps at once.

Pixel positions are continuous: the centre of the top-left pixel is (0.5, 0.5). Depth is z-depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from core_rasterizer import Camera

Floats = NDArray[np.floating[Any]]
DepthImage = NDArray[np.float32]
"""`[H, W]` z-depth in world units; 0 where it is not known."""
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def pixel_centers(camera: Camera) -> tuple[Floats, Floats]:
    """Columns and rows of all pixel centres, `[H, W]` each."""
    u, v = camera.pixel_centers()
    return u.numpy(), v.numpy()


def lift(camera: Camera, u: Floats, v: Floats, depth: Floats | DepthImage) -> Floats:
    """World points `[..., 3]` behind pixel positions at a depth."""
    points: Floats = camera.unproject(*map(torch.from_numpy, (u, v, depth))).numpy()
    return points


def project(camera: Camera, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixel position and depth (u, v, z) of world points `[..., 3]`.

    Behind the camera z <= 0, and u and v are infinite.
    """
    u, v, z = (values.numpy() for values in camera.project(torch.from_numpy(points)))
    return np.where(z > 0, u, np.inf), np.where(z > 0, v, np.inf), z


def inside(camera: Camera, u: Floats, v: Floats) -> Mask:
    """Which pixel positions lie in the image."""
    mask: Mask = camera.contains(torch.from_numpy(u), torch.from_numpy(v)).numpy()
    return mask


def look_up(depth: DepthImage, u: Floats, v: Floats) -> Floats:
    """The depth of the pixel that each position falls into; 0 outside the image or where unknown."""
    height, width = depth.shape
    within = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    column = np.where(within, u, 0).astype(np.intp)
    row = np.where(within, v, 0).astype(np.intp)
    return np.where(within, depth[row, column], 0.0)


def interpolate(depth: DepthImage, u: Floats, v: Floats) -> Floats:
    """Depth between pixel centres; 0 outside the image or where no neighbour is known.

    Inverse depth is interpolated bilinearly, over the known ones of the four neighbours: that is
    exact on any plane.
    """
    height, width = depth.shape
    within = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    x, y = np.where(within, u, 0.0) - 0.5, np.where(within, v, 0.0) - 0.5
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right_share, bottom_share = x - left, y - top
    nearness = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    total, weights = np.zeros_like(x), np.zeros_like(x)
    for column, share_x in ((left, 1 - right_share), (left + 1, right_share)):
        for row, share_y in ((top, 1 - bottom_share), (top + 1, bottom_share)):
            value = nearness[row.clip(0, height - 1), column.clip(0, width - 1)]
            weight = share_x * share_y * (value > 0)
            total += weight * value
            weights += weight
    known = within & (weights > 1e-6)
    return np.divide(weights, total, out=np.zeros_like(x), where=known)
