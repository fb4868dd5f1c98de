"""Depth for pixels without one, guessed from the pixels around them and held against other views.

A hole mostly is background that another camera cannot see, so of the nearest known depths in eight
directions a rather far one is taken, of a surface with the hole's colour if there is one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..image_filters import blurred

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..projection import DepthImage, Floats, Indices, Mask

Scalar = TypeVar("Scalar", bound=np.generic)

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
    height, width = depth.shape
    smooth = blurred(image, NOISE_BLUR, outside="mirrored").reshape(-1, 3).T.copy()
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
    index = np.arange(known.size).reshape(known.shape)
    above, below = _nearest_along(known, index, 0)
    left, right = _nearest_along(known, index, 1)
    above_right, below_left = _nearest_along_diagonals(known, index)
    # Of the mirror image these diagonals are the other ones.
    mirrored = _nearest_along_diagonals(known[:, ::-1], index[:, ::-1])
    above_left, below_right = (answer[:, ::-1] for answer in mirrored)
    return [above, left, below, right, below_right, above_left, below_left, above_right]


def _nearest_along(known: Mask, index: Indices, axis: int) -> tuple[Indices, Indices]:
    """The nearest known index up to each pixel along an axis, and that from it on; -1 where none is.

    Args:
        index: grows along the axis, so that the nearest is the largest before and the smallest behind.
    """
    nowhere = known.size
    before = np.maximum.accumulate(np.where(known, index, -1), axis=axis)
    behind = np.flip(np.where(known, index, nowhere), axis)
    behind = np.flip(np.minimum.accumulate(behind, axis=axis), axis)
    return before, np.where(behind < nowhere, behind, -1)


def _nearest_along_diagonals(known: Mask, index: Indices) -> tuple[Indices, Indices]:
    """The same from above right and from below left: columns once each row is moved by its number."""
    height, width = known.shape
    before, behind = (
        np.append(answer, np.zeros(height, dtype=np.intp)).reshape(height, -1)[:, :width]
        for answer in _nearest_along(_sheared(known), _sheared(index), 0)
    )
    return before, behind


def _sheared(image: NDArray[Scalar]) -> NDArray[Scalar]:
    """The image `[H, W]` with each row moved to the right by its number, `[H, H + W]`; 0 beside it."""
    height, width = image.shape
    longer = np.pad(image, ((0, 0), (0, height + 1)))
    return longer.ravel()[:-height].reshape(height, height + width)


def _likeness(smooth: NDArray[np.float32], pixels: Indices, others: Indices) -> Floats:
    """How alike the colours of pixels `[P]` and of others `[K, P]` are, in (0, 1].

    Args:
        smooth: `[3, N]`, a channel after the other, which is several times as fast as pixel by pixel.
    """
    squared = np.zeros(others.shape, dtype=np.float32)
    for channel in smooth:
        squared += (channel[others] - channel[pixels]) ** 2
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
