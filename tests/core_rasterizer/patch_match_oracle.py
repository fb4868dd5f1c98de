"""Reference costs of PatchMatch in float64, without rounding of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core_rasterizer import Camera
from tests.core_rasterizer.plane_sweep_oracle import Floats, interpolate

COLOR_SPREAD = 0.2
"""Standard deviation of grey values in [0, 1] of one surface."""
NOISE = 0.001
"""Standard deviation of grey values in [0, 1] that counts as no texture."""


def costs(
    images: Sequence[Floats], cameras: Sequence[Camera], planes: Floats, radius: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """Costs of the first view's planes in all others.

    Args:
        planes: `[3, H, W]`: the inverse depth at each pixel and its steps to the right and down.

    Returns:
        `[S, H, W]` 1 - NCC, 2 where the pixel's point is not seen; and where that is nearly decided by
        rounding.
    """
    image, here = images[0], cameras[0]
    nearness, right, down = planes
    column, row = np.meshgrid(np.arange(here.width), np.arange(here.height))
    offsets = range(-radius, radius + 1)
    weights, values, others = [], [], []
    for v in offsets:
        for u in (u for u in offsets if (u + v) % 2 == 0):
            at, below = column + u, row + v
            within = (at >= 0) & (at < here.width) & (below >= 0) & (below < here.height)
            value = image[np.clip(below, 0, here.height - 1), np.clip(at, 0, here.width - 1)]
            off = (value - image) / COLOR_SPREAD
            weights.append(within * np.exp(-(off**2) / 2 - (u * u + v * v) / (2 * radius**2)))
            values.append(value)
            there = [
                _land(here, c, at, below, nearness + u * right + v * down) for c in cameras[1:]
            ]
            others.append(
                [interpolate(i, a, b) for i, (a, b, _) in zip(images[1:], there, strict=True)]
            )
    weight = np.stack(weights) / np.sum(weights, axis=0)
    answers, unsure = [], []
    for index, camera in enumerate(cameras[1:]):
        cost = 1 - _correlation(weight, np.stack(values), np.stack([o[index] for o in others]))
        x, y, z = _land(here, camera, column, row, nearness)
        distance = np.minimum(np.minimum(x, y), np.minimum(camera.width - x, camera.height - y))
        answers.append(np.where((z > 0) & (distance >= 0), cost, 2.0))
        unsure.append(np.abs(distance) < 1e-3)
    return np.stack(answers), np.stack(unsure)


def _land(
    here: Camera, there: Camera, column: NDArray[Any], row: NDArray[Any], nearness: Floats
) -> tuple[Floats, Floats, Floats]:
    """Pixel position in another view, and depth there, of pixels at an inverse depth."""
    x, y = (column + 0.5 - here.cx) / here.fx, (row + 0.5 - here.cy) / here.fy
    # Homogeneous, so that an inverse depth of 0 or less is no exception.
    local = np.stack([x, y, np.ones_like(x), nearness])
    pose = there.world_to_camera.numpy() @ here.camera_to_world.numpy()
    a, b, c, _ = np.tensordot(pose, local, 1)
    return there.fx * a / c + there.cx, there.fy * b / c + there.cy, c


def _correlation(weight: Floats, first: Floats, second: Floats) -> Floats:
    """Weighted over the first axis, of values `[N, H, W]`."""
    a = first - (weight * first).sum(axis=0)
    b = second - (weight * second).sum(axis=0)
    spread = [(weight * values**2).sum(axis=0) + NOISE**2 for values in (a, b)]
    correlation: Floats = (weight * a * b).sum(axis=0) / np.sqrt(spread[0] * spread[1])
    return correlation
