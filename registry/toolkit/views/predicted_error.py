"""PSNR of a view: measured, and as a confidence predicts it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

RIGHT = 0.1
"""Largest mean difference of a pixel's channels from a photograph at which it is right; colours in [0, 1]."""
MIN_ERROR = 1e-10
"""Lower bound of the mean squared error: equal images score 100 dB, not infinity."""
_LEAST, _MOST = 0.02, 0.9999


def decibels(squared_error: float | Tensor) -> float:
    """Return the PSNR, at most 100 dB, of a mean squared error; colours in [0, 1]."""
    return -10 * math.log10(max(float(squared_error), MIN_ERROR))


def predicted_psnr(confidence: Tensor) -> float:
    """Return the PSNR in decibels that a confidence predicts, without a photograph.

    A confidence c is read as the probability 1 - exp(-0.1 / m) of an error of at most 0.1, where errors have
    an exponential distribution with mean m and mean square 2 m^2.

    Args:
        confidence: of the pixels, any shape, in [0, 1].
    """
    mean = -RIGHT / (1 - confidence.double().clamp(_LEAST, _MOST)).log()
    return decibels((2 * mean.square()).mean())
