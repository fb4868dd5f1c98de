"""`ssim_skimage`: structural similarity with scikit-image's defaults, as in the NeRF literature.

A uniform 7x7 window, sample covariance, mean over the image without a border of 3 pixels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Metric, Register, Unavailable, hookimpl
from registry.toolkit.images import ImageMetricSettings

if TYPE_CHECKING:
    from torch import Tensor

WINDOW = 7
"""Side of the window in pixels, scikit-image's default."""


class ScikitImageSSIM(Metric[ImageMetricSettings]):
    """With a mask, both images are set to white outside it, and all pixels count (the DTU protocol)."""

    average_error_role = "structural_similarity"

    def measure(
        self, rendered: Tensor, photograph: Tensor, mask: Tensor | None
    ) -> float | Unavailable:
        """Return the similarity, at most 1; not available below 7x7 pixels."""
        if min(photograph.shape[:2]) < WINDOW:
            return Unavailable(f"the image is smaller than the window of {WINDOW}x{WINDOW} pixels")
        from skimage.metrics import structural_similarity

        from registry.toolkit.images import white_outside

        first, second = (
            white_outside(self.settings.prepared(image), mask).numpy()
            for image in (rendered, photograph)
        )
        score = structural_similarity(
            first, second, win_size=WINDOW, data_range=1.0, channel_axis=2
        )
        return float(score)


@hookimpl
def stereogs_register_metrics(register: Register[ScikitImageSSIM]) -> None:
    register("ssim_skimage", ScikitImageSSIM)
