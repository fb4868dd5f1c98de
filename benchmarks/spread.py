"""Means over seeds with their spread, as cells of a table."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

NONE = "\u2013"
"""A cell without a number."""


def spread(values: Sequence[float], form: str = ".2f") -> str:
    """A mean, with the sample standard deviation where there are several."""
    if not values:
        return NONE
    mean = format(statistics.mean(values), form)
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):{form}}"
