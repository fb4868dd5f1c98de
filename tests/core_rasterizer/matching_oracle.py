"""Plain float64 and integer twins of the matching kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core_rasterizer.matching import Penalties

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_DIRECTIONS = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)]


def aggregate(costs: Ints, grey: Ints, penalties: Penalties) -> Ints:
    """Sum of path costs `[H, W, D]` over eight directions, pixel by pixel (grey in 0..255)."""
    height, width, planes = costs.shape
    total = np.zeros_like(costs)
    for down, right in _DIRECTIONS:
        path = np.zeros_like(costs)
        for y in range(height)[:: down or 1]:
            for x in range(width)[:: right or 1]:
                before_y, before_x = y - down, x - right
                path[y, x] = costs[y, x]
                if not (0 <= before_y < height and 0 <= before_x < width):
                    continue
                before = path[before_y, before_x]
                step = abs(int(grey[y, x]) - int(grey[before_y, before_x]))
                jump = max(penalties.small, penalties.large // max(1, step))
                wide = np.pad(before, 1, constant_values=10**9) + penalties.small
                options = [before, wide[:-2], wide[2:], np.full(planes, before.min() + jump)]
                path[y, x] += np.min(options, axis=0) - before.min()
        total += path
    return total


def cheapest(sums: Ints, planes: int) -> tuple[Floats, Floats]:
    """Plane with fraction and confidence, `[H, W]` each, one pixel after another."""
    height, width, _ = sums.shape
    index, confidence = np.zeros((height, width)), np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            row = sums[y, x, :planes]
            best = int(row.argmin())
            index[y, x] = best
            if 0 < best < planes - 1:
                below, above = row[best - 1] - row[best], row[best + 1] - row[best]
                index[y, x] += 0.5 * (below - above) / max(below, above, 1)
            rivals = [row[d] for d in range(planes) if abs(d - best) > 1]
            if rivals and min(rivals) > 0:
                confidence[y, x] = 1 - row[best] / min(rivals)
    return index, confidence


def zncc(left: Floats, right: Floats, planes: int, radius: int) -> Ints:
    """Costs `[H, W, planes]` of grey images in [0, 1], each window on its own."""
    noise, pixels = 0.002, (2 * radius + 1) ** 2

    def windows(image: Floats) -> Floats:
        side = (2 * radius + 1, 2 * radius + 1)
        found = np.lib.stride_tricks.sliding_window_view(np.pad(image, radius, "edge"), side)
        flat = found.reshape(*image.shape, -1)
        centered: Floats = flat - flat.mean(-1, keepdims=True)
        scales: Floats = np.sqrt((centered**2).sum(-1, keepdims=True) + pixels * noise**2)
        return centered / scales

    return features(windows(left), windows(right), planes)


def features(left: Floats, right: Floats, planes: int) -> Ints:
    """Costs `[H, W, planes]` of feature vectors `[H, W, C]`."""
    height, width, _ = left.shape
    costs = np.full((height, width, planes), 128, dtype=np.int64)
    for d in range(min(planes, width)):
        dots = (left[:, d:] * right[:, : width - d]).sum(-1)
        costs[:, d:, d] = np.floor(127.5 * (1 - np.clip(dots, -1, 1)) + 0.5)
    return costs


def census(left: Floats, right: Floats, planes: int) -> Ints:
    """Costs `[H, W, planes]`: 255 times the share of differing signs of windows 9 wide and 7 high."""
    height, width = left.shape
    bits: list[list[NDArray[np.bool_]]] = [[], []]
    for image, found in zip((left, right), bits, strict=True):
        padded = np.pad(image, ((3, 3), (4, 4)), "edge")
        for down in range(7):
            for across in range(9):
                found.append(padded[down : down + height, across : across + width] < image)
    signs = [np.stack(found, -1) for found in bits]
    costs = np.full((height, width, planes), 96, dtype=np.int64)
    for d in range(min(planes, width)):
        differing = (signs[0][:, d:] != signs[1][:, : width - d]).sum(-1)
        costs[:, d:, d] = np.floor(255 * differing / 62 + 0.5)
    return costs
