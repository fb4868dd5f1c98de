"""Plain float64 twins of the plane sweeps, without rounding."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from core_rasterizer import Camera

Floats = NDArray[np.float64]
UNKNOWN = 128.0


def landing(
    reference: Camera, source: Camera, depth: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where the reference's pixels, at one depth, lie in the source: u, v `[H, W]`, and whether inside."""
    columns, rows = np.meshgrid(np.arange(reference.width) + 0.5, np.arange(reference.height) + 0.5)
    local = np.stack(
        [
            (columns - reference.cx) / reference.fx * depth,
            (rows - reference.cy) / reference.fy * depth,
            np.full_like(columns, depth),
            np.ones_like(columns),
        ]
    )
    pose = source.world_to_camera.numpy() @ reference.camera_to_world.numpy()
    x, y, z, _ = np.tensordot(pose, local, 1)
    u, v = source.fx * x / z + source.cx, source.fy * y / z + source.cy
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u <= source.width) & (v <= source.height)
    return u, v, inside


def interpolate(image: Floats, u: Floats, v: Floats) -> Floats:
    """Bilinear samples `[H, W, ...]` of an image, clamped at the border."""
    height, width = image.shape[:2]
    u, v = np.clip(u - 0.5, 0, width - 1), np.clip(v - 0.5, 0, height - 1)
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    a, b = (part.reshape(part.shape + (1,) * (image.ndim - 2)) for part in (u - left, v - top))
    upper = (1 - a) * image[top, left] + a * image[top, right]
    lower = (1 - a) * image[bottom, left] + a * image[bottom, right]
    sampled: Floats = (1 - b) * upper + b * lower
    return sampled


def windowed(values: Floats, radius: int) -> Floats:
    """Mean `[H, W]` over the window around each pixel, cropped at the border."""
    side = (2 * radius + 1,) * 2
    padded, inside = np.pad(values, radius), np.pad(np.ones_like(values), radius)
    sums, counts = (sliding_window_view(a, side).sum(axis=(2, 3)) for a in (padded, inside))
    means: Floats = sums / counts
    return means


def zncc(first: Floats, second: Floats, radius: int, noise: float) -> Floats:
    """Correlation `[H, W]` of the windows of two images."""
    a, b = windowed(first, radius), windowed(second, radius)
    spread_a, spread_b = windowed(first**2, radius) - a**2, windowed(second**2, radius) - b**2
    covariance = windowed(first * second, radius) - a * b
    return covariance / np.sqrt((spread_a + noise**2) * (spread_b + noise**2))


def zncc_costs(
    images: Sequence[Floats],
    cameras: Sequence[Camera],
    inverse_depths: Sequence[float],
    *,
    radius: int,
    noise: float,
    second_share: float,
) -> Floats:
    """Costs `[H, W, P]` of the first view against all others."""

    def similarity(index: int, u: Floats, v: Floats) -> Floats:
        return zncc(images[0], interpolate(images[index], u, v), radius, noise)

    return _costs(cameras, inverse_depths, similarity, second_share)


def feature_costs(
    features: Sequence[Floats],
    cameras: Sequence[Camera],
    inverse_depths: Sequence[float],
    *,
    second_share: float,
) -> Floats:
    """The same for features `[H, W, C]`."""

    def similarity(index: int, u: Floats, v: Floats) -> Floats:
        products: Floats = features[0] * interpolate(features[index], u, v)
        total: Floats = products.sum(axis=2)
        return total

    return _costs(cameras, inverse_depths, similarity, second_share)


def _costs(
    cameras: Sequence[Camera],
    inverse_depths: Sequence[float],
    similarity: Callable[[int, Floats, Floats], Floats],
    second_share: float,
) -> Floats:
    planes = []
    for inverse_depth in inverse_depths:
        found = []
        for index in range(1, len(cameras)):
            u, v, inside = landing(cameras[0], cameras[index], 1 / inverse_depth)
            cost = np.clip(127.5 - 127.5 * similarity(index, u, v), 0, 255)
            found.append(np.where(inside, cost, np.inf))
        found.append(np.full_like(found[0], np.inf))
        best, second = np.sort(found, axis=0)[:2]
        with np.errstate(invalid="ignore"):
            joint = np.where(second < np.inf, best + second_share * (second - best), best)
        planes.append(np.where(best < np.inf, joint, UNKNOWN))
    return np.stack(planes, axis=2)
