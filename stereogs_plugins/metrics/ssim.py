"""`ssim`: structural similarity as the 3D Gaussian Splatting literature measures it.

Wang et al. 2004 with an 11x11 Gaussian window (sigma 1.5), zero padding, biased moments, C1 = 0.01²,
C2 = 0.03², mean over all pixels and channels. `ssim_skimage` is the definition of the NeRF literature.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

from registry import Metric, Register, hookimpl
from registry.toolkit.images import ImageMetricSettings, row_bands, white_outside

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

RADIUS = 5
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2

Image: TypeAlias = "np.ndarray[Any, Any]"


class SSIM(Metric[ImageMetricSettings]):
    """With a mask, both images are set to white outside it, and all pixels count (the DTU protocol)."""

    average_error_role = "structural_similarity"

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        """Return the similarity, at most 1."""
        height, width = photograph.shape[:2]
        total = 0.0
        for rows in row_bands(height, width):
            wider = slice(max(rows.start - RADIUS, 0), rows.stop + RADIUS)
            first, second = (
                white_outside(
                    self.settings.prepared(image[wider]), None if mask is None else mask[wider]
                ).numpy()
                for image in (rendered, photograph)
            )
            start = rows.start - wider.start
            total += _similarity(first, second)[start : start + rows.stop - rows.start].sum()
        return float(total / photograph.numel())


def _similarity(first: Image, second: Image) -> Image:
    """Return the similarity of each pixel and channel of two images, `[H, W, C]`."""
    from registry.toolkit.progress import in_parallel

    images = (first, second, first * first, second * second, first * second)
    mean_1, mean_2, square_1, square_2, product = in_parallel(_blur, images)
    variance_1 = square_1 - mean_1**2
    variance_2 = square_2 - mean_2**2
    covariance = product - mean_1 * mean_2
    similarity: Image = ((2 * mean_1 * mean_2 + C1) * (2 * covariance + C2)) / (
        (mean_1**2 + mean_2**2 + C1) * (variance_1 + variance_2 + C2)
    )
    return similarity


def _blur(image: Image) -> Image:
    import cv2
    import numpy as np

    window = np.exp(-(np.arange(-RADIUS, RADIUS + 1) ** 2) / (2 * SIGMA**2))
    window /= window.sum()
    return cv2.sepFilter2D(image, cv2.CV_64F, window, window, borderType=cv2.BORDER_CONSTANT)


@hookimpl
def stereogs_register_metrics(register: Register[SSIM]) -> None:
    register("ssim", SSIM)
