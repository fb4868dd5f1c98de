"""Hole filling: depths guessed from the pixels around a hole.

A hole is mostly background that another camera cannot see. It takes a rather far one of the nearest known
depths in eight directions, preferably of a surface with the hole's colour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..image_filters import blurred

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..projection import Colors, DepthImage, Floats, Indices, Mask

Scalar = TypeVar("Scalar", bound=np.generic)

QUANTILE = 0.2
"""Weighted quantile of the inverse depths around a hole: rather far."""
COLOR_RANGE = 0.1
"""Standard deviation of the colours of one surface; white is 1."""
MIN_WEIGHT = 0.02
"""Least weight of a neighbour, so that holes without similar neighbours are filled too."""
NOISE_BLUR = 1.0
"""Standard deviation of the blur before colours are compared, pixels."""
SMOOTHING_REACH, SMOOTHING_STEP = 6, 3
"""Reach and step of the weighted median, pixels."""


def fill_holes(image: Colors, depth: DepthImage) -> DepthImage:
    """Guess depths for the pixels without one; all others are 0.

    A pixel stays 0 if no depth is known in the eight directions from it and its neighbours.

    Args:
        image: `[H, W, 3]`; depth edges follow its edges.
        depth: 0 in holes.
    """
    height, width = depth.shape
    smooth = blurred(image, NOISE_BLUR, outside="mirrored").reshape(-1, 3).T.copy()
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=known).ravel()
    holes = np.flatnonzero(~known)
    around = np.stack([index.ravel()[holes] for index in nearest_known(known)])
    seen = np.where(around >= 0, inverse[around], 0.0)
    inverse[holes] = _quantile(seen, _likeness(smooth, holes, around), QUANTILE)
    around = _surroundings(holes, height, width)
    guess = _quantile(inverse[around], _likeness(smooth, holes, around), 0.5)
    filled = np.zeros(depth.size, dtype=np.float32)
    filled[holes] = np.divide(1.0, guess, out=np.zeros_like(guess), where=guess > 0)
    return filled.reshape(height, width)


def nearest_known(known: Mask) -> list[Indices]:
    """Flat index `[H, W]` of the nearest known pixel in each of eight directions; -1 if none."""
    index = np.arange(known.size).reshape(known.shape)
    above, below = _nearest_along(known, index, 0)
    left, right = _nearest_along(known, index, 1)
    above_right, below_left = _nearest_along_diagonals(known, index)
    # The other two diagonals are those of the mirrored image.
    mirrored = _nearest_along_diagonals(known[:, ::-1], index[:, ::-1])
    above_left, below_right = (answer[:, ::-1] for answer in mirrored)
    return [above, left, below, right, below_right, above_left, below_left, above_right]


def _nearest_along(known: Mask, index: Indices, axis: int) -> tuple[Indices, Indices]:
    """The nearest known index before and after each pixel along an axis; -1 if none.

    Args:
        index: grows along the axis, so the nearest is the largest before and the smallest after.
    """
    nowhere = known.size
    before = np.maximum.accumulate(np.where(known, index, -1), axis=axis)
    behind = np.flip(np.where(known, index, nowhere), axis)
    behind = np.flip(np.minimum.accumulate(behind, axis=axis), axis)
    return before, np.where(behind < nowhere, behind, -1)


def _nearest_along_diagonals(known: Mask, index: Indices) -> tuple[Indices, Indices]:
    """The same from above right and from below left, as columns of a sheared image."""
    height, width = known.shape
    before, behind = (
        np.append(answer, np.zeros(height, dtype=np.intp)).reshape(height, -1)[:, :width]
        for answer in _nearest_along(_sheared(known), _sheared(index), 0)
    )
    return before, behind


def _sheared(image: NDArray[Scalar]) -> NDArray[Scalar]:
    """The image `[H, W]` with row r shifted to the right by r, `[H, H + W]`; 0 elsewhere."""
    height, width = image.shape
    longer = np.pad(image, ((0, 0), (0, height + 1)))
    return longer.ravel()[:-height].reshape(height, height + width)


def _likeness(smooth: Colors, pixels: Indices, others: Indices) -> Floats:
    """Similarity of the colours of pixels `[P]` and of others `[K, P]`, in (0, 1 + MIN_WEIGHT].

    Args:
        smooth: `[3, N]`; channel-first is several times as fast.
    """
    squared = np.zeros(others.shape, dtype=np.float32)
    for channel in smooth:
        squared += (channel[others] - channel[pixels]) ** 2
    likeness: Floats = np.exp(-squared / (2 * COLOR_RANGE**2)) + MIN_WEIGHT
    return likeness


def _quantile(values: Floats, weights: Floats, share: float) -> Floats:
    """Weighted quantile of `values` `[K, P]` along the first axis; zeros are unknown and ignored.

    The result is 0 where all are unknown.
    """
    order = np.argsort(values, axis=0, kind="stable")
    ordered = np.take_along_axis(values, order, axis=0)
    summed = np.cumsum(np.take_along_axis(weights, order, axis=0) * (ordered > 0), axis=0)
    place = (summed < share * summed[-1]).sum(axis=0)
    answer: Floats = np.take_along_axis(ordered, place[None], axis=0)[0]
    return answer


def _surroundings(pixels: Indices, height: int, width: int) -> Indices:
    """Flat indices `[K, P]` of each SMOOTHING_STEP-th pixel within SMOOTHING_REACH of each pixel."""
    row, column = np.divmod(pixels, width)
    offsets = range(-SMOOTHING_REACH, SMOOTHING_REACH + 1, SMOOTHING_STEP)
    return np.stack(
        [
            (row + down).clip(0, height - 1) * width + (column + right).clip(0, width - 1)
            for down in offsets
            for right in offsets
        ]
    )
