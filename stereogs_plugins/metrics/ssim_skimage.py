"""`ssim_skimage`: structural similarity with scikit-image's defaults, as the NeRF literature measures it.

A uniform 7x7 window, sample covariance, mean over the image without a border of 3 pixels.
"""

from __future__ import annotations

from torch import Tensor

from registry import ImageMetricSettings, Metric, Register, hookimpl, white_outside


class ScikitImageSSIM(Metric[ImageMetricSettings]):
    """With a mask, both images are white outside it, and all pixels count (the DTU protocol)."""

    Settings = ImageMetricSettings
    average_error_role = "structural_similarity"

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        """Return the similarity, at most 1. The images must be at least 7x7."""
        from skimage.metrics import structural_similarity

        first, second = (
            white_outside(self.settings.prepared(image), mask).numpy()
            for image in (rendered, photograph)
        )
        score = structural_similarity(first, second, data_range=1.0, channel_axis=2)
        return float(score)


@hookimpl
def stereogs_register_metrics(register: Register[ScikitImageSSIM]) -> None:
    register("ssim_skimage", ScikitImageSSIM)
