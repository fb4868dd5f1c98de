"""`psnr`: peak signal-to-noise ratio, -10 log10(mean squared error), values in [0, 1]."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Metric, Register, SceneError, hookimpl
from registry.toolkit.images import ImageMetricSettings, decibels, row_bands

if TYPE_CHECKING:
    from torch import Tensor


class PSNR(Metric[ImageMetricSettings]):
    """Over all pixels and channels; with a mask, over the pixels inside it."""

    unit = "dB"
    average_error_role = "peak_signal_to_noise_ratio"

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        """Return decibels, at most 100.

        Raises:
            SceneError: the mask is empty.
        """
        if mask is not None and not mask.any():
            raise SceneError("the mask is empty", fix="check the mask file")
        total, count = 0.0, 0
        for rows in row_bands(*photograph.shape[:2]):
            first, second = (
                self.settings.prepared(image[rows]) for image in (rendered, photograph)
            )
            squares = (first - second) ** 2
            if mask is not None:
                squares = squares[mask[rows]]
            total += float(squares.sum())
            count += squares.numel()
        return decibels(total / count)


@hookimpl
def stereogs_register_metrics(register: Register[PSNR]) -> None:
    register("psnr", PSNR)
