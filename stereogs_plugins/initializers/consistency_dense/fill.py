"""Depth for pixels without one, guessed from the pixels around them and held against other views.

A hole mostly is background that another camera cannot see, so of the nearest known depths in eight
directions a rather far one is taken, of a surface with the hole's colour if there is one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .projection import DepthImage, Floats, Indices, Mask

QUANTILE = 0.2
"""Of the inverse depths around a hole, by weight: rather far, for holes are mostly background."""
COLOR_RANGE = 0.1
"""Standard deviation of colours of one surface, in units of white."""
LEAST_WEIGHT = 0.02
"""Of a neighbour of quite another colour, so that a hole without its like is filled too."""
NOISE_BLUR = 1.0
"""Pixels; single noisy pixels must not decide which colours are alike."""
SMOOTHING_REACH, SMOOTHING_STEP = 6, 3
"""The weighted median looks at pixels this far away, every so many pixels."""


def fill_holes(image: NDArray[np.float32], depth: DepthImage) -> DepthImage:
    """Depths for the pixels that have none, 0 for all others.

    A pixel stays 0 if nothing is known in any direction from it, nor from those beside it.

    Args:
        image: `[H, W, 3]`; depth edges are put where its edges are.
        depth: 0 in holes.
    """
    from scipy.ndimage import gaussian_filter  # type: ignore[attr-defined]

    height, width = depth.shape
    smooth = gaussian_filter(image, (NOISE_BLUR, NOISE_BLUR, 0)).reshape(-1, 3)
    known = depth > 0
    nearness = np.divide(1.0, depth, out=np.zeros(depth.shape), where=known).ravel()
    holes = np.flatnonzero(~known)
    around = np.stack([index.ravel()[holes] for index in nearest_known(known)])
    seen = np.where(around >= 0, nearness[around], 0.0)
    nearness[holes] = _quantile(seen, _likeness(smooth, holes, around), QUANTILE)
    around = _surroundings(holes, height, width)
    guess = _quantile(nearness[around], _likeness(smooth, holes, around), 0.5)
    filled = np.zeros(depth.size, dtype=np.float32)
    filled[holes] = np.divide(1.0, guess, out=np.zeros_like(guess), where=guess > 0)
    return filled.reshape(height, width)


def nearest_known(known: Mask) -> list[Indices]:
    """Flat index `[H, W]` of the nearest known pixel in eight directions; -1 where there is none."""
    height, width = known.shape
    index = np.where(known, np.arange(known.size).reshape(height, width), -1)
    columns = np.arange(height)[:, None] + np.arange(width)
    rows = np.broadcast_to(np.arange(height)[:, None], known.shape)
    answers = [_last_known(index, axis) for axis in (0, 1)]
    answers += [np.flip(_last_known(np.flip(index, axis), axis), axis) for axis in (0, 1)]
    for mirror in (1, -1):
        # Shifting each row by its number turns diagonals into columns.
        sheared = np.full((height, height + width), -1, dtype=np.intp)
        sheared[rows, columns] = index[::-1, ::mirror]
        down = _last_known(sheared, 0)
        up = np.flip(_last_known(np.flip(sheared, 0), 0), 0)
        answers += [answer[rows, columns][::-1, ::mirror] for answer in (down, up)]
    return answers


def _last_known(index: Indices, axis: int) -> Indices:
    """The last entry >= 0 up to each place along an axis, or -1."""
    places = np.arange(index.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    last = np.maximum.accumulate(np.where(index >= 0, places, -1), axis=axis)
    found = np.take_along_axis(index, last.clip(0), axis=axis)
    return np.where(last >= 0, found, -1)


def _likeness(smooth: NDArray[np.float32], pixels: Indices, others: Indices) -> Floats:
    """How alike the colours of pixels `[P]` and of others `[K, P]` are, in (0, 1]."""
    squared = ((smooth[others] - smooth[pixels]) ** 2).sum(axis=-1)
    likeness: Floats = np.exp(-squared / (2 * COLOR_RANGE**2)) + LEAST_WEIGHT
    return likeness


def _quantile(nearness: Floats, weights: Floats, share: float) -> Floats:
    """The smallest of `nearness` `[K, P]` at which the summed weights reach a share of their total.

    Unknown ones, 0, have no weight; where all are unknown the answer is 0.
    """
    order = np.argsort(nearness, axis=0, kind="stable")
    ordered = np.take_along_axis(nearness, order, axis=0)
    summed = np.cumsum(np.take_along_axis(weights, order, axis=0) * (ordered > 0), axis=0)
    place = (summed < share * summed[-1]).sum(axis=0)
    answer: Floats = np.take_along_axis(ordered, place[None], axis=0)[0]
    return answer


def _surroundings(pixels: Indices, height: int, width: int) -> Indices:
    """Flat indices `[K, P]` of every SMOOTHING_STEP-th pixel up to SMOOTHING_REACH from each pixel."""
    row, column = np.divmod(pixels, width)
    offsets = range(-SMOOTHING_REACH, SMOOTHING_REACH + 1, SMOOTHING_STEP)
    return np.stack(
        [
            (row + down).clip(0, height - 1) * width + (column + right).clip(0, width - 1)
            for down in offsets
            for right in offsets
        ]
    )
