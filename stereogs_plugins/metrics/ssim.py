"""`ssim`: structural similarity as the 3D Gaussian Splatting literature measures it.

Wang et al. 2004 with an 11x11 Gaussian window (sigma 1.5), zero padding, biased moments, C1 = 0.01²,
C2 = 0.03², mean over all pixels and channels. `ssim_skimage` is the definition of the NeRF literature.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

from registry import Metric, Register, hookimpl
from registry.toolkit.drawing import ImageMetricSettings

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
        from registry.toolkit.drawing import white_outside
        from registry.toolkit.photos import in_parallel

        first, second = (
            white_outside(self.settings.prepared(image), mask).numpy()
            for image in (rendered, photograph)
        )
        images = (first, second, first * first, second * second, first * second)
        mean_1, mean_2, square_1, square_2, product = in_parallel(_blur, images)
        variance_1 = square_1 - mean_1**2
        variance_2 = square_2 - mean_2**2
        covariance = product - mean_1 * mean_2
        similarity = ((2 * mean_1 * mean_2 + C1) * (2 * covariance + C2)) / (
            (mean_1**2 + mean_2**2 + C1) * (variance_1 + variance_2 + C2)
        )
        return float(similarity.mean())


def _blur(image: Image) -> Image:
    import cv2
    import numpy as np

    window = np.exp(-(np.arange(-RADIUS, RADIUS + 1) ** 2) / (2 * SIGMA**2))
    window /= window.sum()
    return cv2.sepFilter2D(image, cv2.CV_64F, window, window, borderType=cv2.BORDER_CONSTANT)


@hookimpl
def stereogs_register_metrics(register: Register[SSIM]) -> None:
    register("ssim", SSIM)
