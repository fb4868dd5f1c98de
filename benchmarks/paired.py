"""Means over seeds with their spread, and differences over pairs with their interval."""

from __future__ import annotations

import math
import statistics
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from scipy.stats import t as student  # type: ignore[attr-defined]  # its stubs lack distributions

Pair = TypeVar("Pair", bound=Hashable)

ENOUGH_PAIRS = 3
"""Pairs from which on a difference has an interval."""
CONFIDENCE = 0.95
NONE = "\u2013"


@dataclass(frozen=True)
class Difference:
    """How far a method is from the baseline, in dB.

    Args:
        mean: over the pairs.
        half: half the width of its interval; None with too few pairs.
    """

    mean: float
    half: float | None

    def __str__(self) -> str:
        return f"{self.mean:+.2f}" + ("" if self.half is None else f" ± {self.half:.2f}")


def difference(values: Mapping[Pair, float], baseline: Mapping[Pair, float]) -> Difference | None:
    """The mean difference over pairs of the same key, such as scene and seed; None without a pair.

    Its interval is Student's t, from `ENOUGH_PAIRS` pairs on.
    """
    pairs = [value - baseline[key] for key, value in values.items() if key in baseline]
    if not pairs:
        return None
    mean, count = statistics.mean(pairs), len(pairs)
    if count < ENOUGH_PAIRS:
        return Difference(mean, None)
    quantile = float(student.ppf((1 + CONFIDENCE) / 2, count - 1))
    return Difference(mean, quantile * statistics.stdev(pairs) / math.sqrt(count))


def spread(values: Sequence[float], form: str = ".2f") -> str:
    """A mean, with the sample standard deviation where there are several."""
    if not values:
        return NONE
    mean = format(statistics.mean(values), form)
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):{form}}"
