"""Round numbers along an axis."""

from __future__ import annotations

import math


def round_step(wanted: float) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that is at least `wanted` > 0."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= wanted * (1 - 1e-9))


def multiples(step: float, low: float, high: float) -> list[float]:
    """Return the multiples of `step` from `low` to `high`."""
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
