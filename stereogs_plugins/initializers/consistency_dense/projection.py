"""Projection between pixels and world points, for whole depth maps.

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
Colors = NDArray[np.float32]
"""`[..., 3]` in [0, 1]."""
DepthImage = NDArray[np.float32]
"""`[H, W]` z-depth in world units; 0 where unknown."""
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def pixel_centers(camera: Camera) -> tuple[Floats, Floats]:
    """Columns and rows of all pixel centres, `[H, W]` each."""
    u, v = camera.pixel_centers()
    return u.numpy(), v.numpy()


def lift(camera: Camera, u: Floats, v: Floats, depth: Floats | DepthImage) -> Floats:
    """World points `[..., 3]` at pixel positions and depths."""
    points: Floats = camera.unproject(*map(torch.from_numpy, (u, v, depth))).numpy()
    return points


def project(camera: Camera, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixel position and depth (u, v, z) of world points `[..., 3]`; u and v are infinite where z <= 0."""
    u, v, z = (values.numpy() for values in camera.project(torch.from_numpy(points)))
    return np.where(z > 0, u, np.inf), np.where(z > 0, v, np.inf), z


def inside(shape: tuple[int, ...], u: Floats, v: Floats) -> Mask:
    """Pixel positions inside an image of `shape` `(H, W)`."""
    height, width = shape
    return (u >= 0) & (u < width) & (v >= 0) & (v < height)


def pixel_of(shape: tuple[int, ...], u: Floats, v: Floats) -> tuple[Mask, Indices, Indices]:
    """Mask of the positions inside an image, and row and column of their pixels (0 outside)."""
    within = inside(shape, u, v)
    row, column = (np.where(within, x, 0).astype(np.intp) for x in (v, u))
    return within, row, column


def look_up(depth: DepthImage, u: Floats, v: Floats) -> Floats:
    """Depth of the pixel at each position; 0 outside the image or where unknown."""
    within, row, column = pixel_of(depth.shape, u, v)
    return np.where(within, depth[row, column], 0.0)


def interpolate(depth: DepthImage, u: Floats, v: Floats) -> Floats:
    """Depth between pixel centres; 0 outside the image or where no neighbour is known.

    Inverse depth is interpolated bilinearly over the known pixels of the four neighbours, which is exact
    on any plane.
    """
    height, width = depth.shape
    within = inside(depth.shape, u, v)
    x, y = np.where(within, u, 0.0) - 0.5, np.where(within, v, 0.0) - 0.5
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right_share, bottom_share = x - left, y - top
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    total, weights = np.zeros_like(x), np.zeros_like(x)
    for column, share_x in ((left, 1 - right_share), (left + 1, right_share)):
        for row, share_y in ((top, 1 - bottom_share), (top + 1, bottom_share)):
            value = inverse[row.clip(0, height - 1), column.clip(0, width - 1)]
            weight = share_x * share_y * (value > 0)
            total += weight * value
            weights += weight
    known = within & (weights > 1e-6)
    return np.divide(weights, total, out=np.zeros_like(x), where=known)
