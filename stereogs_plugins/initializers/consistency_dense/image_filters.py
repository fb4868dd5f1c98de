"""Filters of photographs, by OpenCV: scipy.ndimage does the same and takes 0.4 s to import."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Colors = NDArray[np.float32]

KERNEL_REACH = 4.0
"""Standard deviations after which a Gaussian counts as 0."""


def blurred(image: Colors, sigma: float, *, outside: Literal["mirrored", "border"]) -> Colors:
    """The image `[H, W, 3]` under a Gaussian.

    Args:
        sigma: standard deviation, pixels.
        outside: what stands beyond the image: the image mirrored at its border, or the border going on.
    """
    import cv2

    reach = int(KERNEL_REACH * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    alone = np.ones(1)
    beyond = cv2.BORDER_REFLECT if outside == "mirrored" else cv2.BORDER_REPLICATE
    # Single precision only between the directions: sums in it would depend on the processor's vectors.
    for along_rows, along_columns in ((alone, weights), (weights, alone)):
        sums = cv2.sepFilter2D(image, cv2.CV_64F, along_rows, along_columns, borderType=beyond)
        image = sums.astype(np.float32)
    return image


def lowest_and_highest(image: Colors, window: int) -> tuple[Colors, Colors]:
    """The least and the largest value of each channel `[H, W, 3]` around each pixel.

    Args:
        window: width of the square around the pixel, odd.
    """
    import cv2

    square = np.ones((window, window), dtype=np.uint8)
    return cv2.erode(image, square), cv2.dilate(image, square)  # type: ignore[return-value]
