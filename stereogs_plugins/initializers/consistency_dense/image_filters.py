"""Image filters by OpenCV. They match `scipy.ndimage`, which takes 0.4 s to import."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from .projection import Colors

KERNEL_REACH = 4.0
"""Standard deviations at which the Gaussian is cut off."""


def blurred(image: Colors, sigma: float, *, outside: Literal["mirrored", "border"]) -> Colors:
    """Gaussian blur of an image `[H, W, 3]`.

    Args:
        sigma: standard deviation, pixels.
        outside: values beyond the border: the mirrored image or the repeated border.
    """
    import cv2

    reach = int(KERNEL_REACH * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    unchanged = np.ones(1)
    border = cv2.BORDER_REFLECT if outside == "mirrored" else cv2.BORDER_REPLICATE
    # Sums in double precision: in single they would depend on the processor's vector width.
    for along_rows, along_columns in ((unchanged, weights), (weights, unchanged)):
        sums = cv2.sepFilter2D(image, cv2.CV_64F, along_rows, along_columns, borderType=border)
        image = sums.astype(np.float32)
    return image


def lowest_and_highest(image: Colors, window: int) -> tuple[Colors, Colors]:
    """Minimum and maximum of each channel `[H, W, 3]` in a square of odd width `window` around each pixel."""
    import cv2

    square = np.ones((window, window), dtype=np.uint8)
    return cv2.erode(image, square), cv2.dilate(image, square)  # type: ignore[return-value]
