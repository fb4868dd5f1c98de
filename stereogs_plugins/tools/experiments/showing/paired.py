"""Differences over pairs of runs, with their interval."""

from __future__ import annotations

import math
import statistics
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

Pair = TypeVar("Pair", bound=Hashable)

ENOUGH_PAIRS = 3
"""Pairs from which on a difference has an interval."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """How far runs are from those that they are compared with.

    Args:
        mean: over the pairs.
        half: half the width of its interval; None with too few pairs.
    """

    mean: float
    half: float | None

    def text(self, decimals: int = 2) -> str:
        """`+0.31 ± 0.08`, without the second number if there is none."""
        mean = f"{self.mean:+.{decimals}f}"
        return mean if self.half is None else f"{mean} ± {self.half:.{decimals}f}"


def difference(values: Mapping[Pair, float], baseline: Mapping[Pair, float]) -> Difference | None:
    """The mean difference over pairs of the same key, such as scene and seed; None without a pair.

    Its interval is Student's t, from `ENOUGH_PAIRS` pairs on.
    """
    from scipy.stats import t as student  # type: ignore[attr-defined]  # its stubs lack distributions

    pairs = [value - baseline[key] for key, value in values.items() if key in baseline]
    if not pairs:
        return None
    mean, count = statistics.mean(pairs), len(pairs)
    if count < ENOUGH_PAIRS:
        return Difference(mean, None)
    quantile = float(student.ppf((1 + CONFIDENCE) / 2, count - 1))
    return Difference(mean, quantile * statistics.stdev(pairs) / math.sqrt(count))
