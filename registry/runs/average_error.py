"""AVGE: one error out of PSNR, SSIM and LPIPS, as RegNeRF's authors and many since report it."""

from __future__ import annotations

AVERAGE_ERROR = "avge"
"""What the scores call it."""


def average_error(psnr: float, ssim: float, lpips: float) -> float:
    """The geometric mean of the mean squared error 10^(-psnr / 10), sqrt(1 - ssim) and LPIPS.

    Niemeyer et al. 2022 (RegNeRF). Lower is better; 0 for equal images.

    Args:
        psnr: decibels.
        ssim: at most 1, by either definition.
        lpips: at least 0.
    """
    squared_error = 10 ** (-psnr / 10)
    # A rounding error above 1 would make the root imaginary.
    dissimilarity = max(1 - ssim, 0.0) ** 0.5
    return float((squared_error * dissimilarity * max(lpips, 0.0)) ** (1 / 3))
