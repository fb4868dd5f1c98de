"""What the runs of an ablation measured, averaged over scenes, with the spread over seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..planning.plan import Combination, Plan, PlannedRun

Results = Mapping[PlannedRun, Mapping[str, Any]]
"""What results.json of each run holds; empty for a run that is not finished."""

COUNTS = {
    "gaussians": "Gaussians",
    "seconds": "seconds",
    "seconds_total": "in all",
    "iterations_per_second": "it/s",
    "peak_memory_mb": "peak MB",
}
"""Measurements of results.json beside the metrics, and their headings."""


NONE = "-"
"""A cell without a number."""


@dataclass(frozen=True)
class Column:
    """Something that was measured.

    Args:
        key: in results.json.
        heading: for tables.
        higher_is_better: None if neither is.
    """

    key: str
    heading: str
    higher_is_better: bool | None


@dataclass(frozen=True)
class Figure:
    """A mean over runs.

    Args:
        mean: over scenes and seeds; may be infinite (the PSNR of equal images).
        spread: sample standard deviation, over the seeds, of the mean over the scenes; None with a
            single seed or an infinite mean.
    """

    mean: float
    spread: float | None

    def text(self, decimals: int, *, spread: bool) -> str:
        """`21.91 ± 0.03`, without the second number if there is none or `spread` is False."""
        mean = f"{self.mean:,.{decimals}f}"
        if self.spread is None or not spread:
            return mean
        return f"{mean} ± {self.spread:,.{decimals}f}"


def columns(plan: Plan, results: Results) -> list[Column]:
    """The metrics that at least one run has a score for, then Gaussians, seconds and memory."""
    directions = {
        item.name: getattr(item.offer.component, "higher_is_better", None)
        for run in plan.runs
        for item in run.pipeline.items["metrics"]
    }
    names = dict.fromkeys(name for found in results.values() for name in found.get("test", {}))
    # The one score that no metric of the pipeline gives, `avge`, is an error.
    found = [Column(name, name, directions.get(name, False)) for name in names]
    found += [Column(key, heading, None) for key, heading in COUNTS.items()]
    return [
        column
        for column in found
        if any(value(run, column) is not None for run in results.values() if run)
    ]


def value(results: Mapping[str, Any], column: Column) -> float | None:
    """One run's number; None if it has none."""
    if column.key in COUNTS:
        number = results.get(column.key)
        return None if number is None else float(number)
    scores = results.get("test", {})
    if column.key not in scores or column.key in results.get("unavailable", {}):
        return None
    score = scores[column.key]
    return math.inf if score is None else float(score)  # JSON knows no infinity


def figure(
    results: Results, combination: Combination, column: Column, scene: str | None = None
) -> Figure | None:
    """A combination's mean over all scenes, or over one; None while a run or a number is missing."""
    by_seed: dict[int, list[float]] = {}
    for run, found in results.items():
        if run.combination == combination and scene in (None, run.scene):
            number = value(found, column)
            if number is None:
                return None
            by_seed.setdefault(run.seed, []).append(number)
    return figure_of(by_seed)


def figure_of(by_seed: Mapping[int, Sequence[float]]) -> Figure | None:
    """The mean of each seed's numbers, one a scene, and its spread; None without any."""
    if not by_seed:
        return None
    means = [sum(numbers) / len(numbers) for numbers in by_seed.values()]
    mean = sum(means) / len(means)
    spread = statistics.stdev(means) if len(means) > 1 and math.isfinite(mean) else None
    return Figure(mean, spread)


def finished(
    results: Results, combination: Combination, scene: str | None = None
) -> tuple[int, int]:
    """How many runs of a combination, of all scenes or of one, are finished, and how many there are."""
    own = [
        found
        for run, found in results.items()
        if run.combination == combination and scene in (None, run.scene)
    ]
    return sum(bool(found) for found in own), len(own)


def without_effect(
    plan: Plan, results: Results, scene: str | None = None
) -> list[list[Combination]]:
    """Combinations whose finished runs have equal hashes seed by seed, in all scenes or in one."""
    groups: dict[tuple[str, ...], list[Combination]] = {}
    for combination in plan.combinations:
        own = [
            found
            for run, found in results.items()
            if run.combination == combination and scene in (None, run.scene)
        ]
        hashes = tuple(str(found.get("hash", "")) for found in own)
        if all(hashes):
            groups.setdefault(hashes, []).append(combination)
    return [group for group in groups.values() if len(group) > 1]


def unavailable(results: Results) -> dict[str, str]:
    """Why a metric has no score, by metric."""
    return {
        name: reason
        for found in results.values()
        for name, reason in found.get("unavailable", {}).items()
    }


def decimals(column: Column, figures: Iterable[Figure | None]) -> int:
    """Decimals that fit a whole column: none for counts, two for dB, four for scores around one."""
    if column.key in COUNTS:
        return 0 if column.key in ("gaussians", "peak_memory_mb") else 1
    means = [abs(found.mean) for found in figures if found is not None]
    return 4 if means and max(means) < 2 else 2
