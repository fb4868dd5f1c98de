"""The results of a plan, averaged over scenes, with the deviation over seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from registry.runs.results import score_of

from ..planning.plan import Combination, Plan, PlannedRun

Results = Mapping[PlannedRun, Mapping[str, Any]]
"""The content of results.json of each run; empty for an unfinished run."""
Value = TypeVar("Value")
Pair = TypeVar("Pair", bound=Hashable)

COUNTS = {
    "gaussians": "Gaussians",
    "seconds": "seconds",
    "seconds_total": "in all",
    "iterations_per_second": "it/s",
    "peak_memory_mb": "peak MB",
}
"""Measurements in results.json other than metrics, with their headings."""

NONE = "-"
"""Text of a cell without a number."""
ENOUGH_PAIRS = 3
"""Smallest number of pairs for a confidence interval."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Column:
    """A measured quantity.

    Args:
        key: in results.json.
        heading: in tables.
        higher_is_better: None if neither direction is better.
    """

    key: str
    heading: str
    higher_is_better: bool | None

    @property
    def heading_with_arrow(self) -> str:
        """The heading with an arrow in the better direction."""
        arrows = {True: " ↑", False: " ↓", None: ""}
        return f"{self.heading}{arrows[self.higher_is_better]}"


@dataclass(frozen=True)
class Figure:
    """A mean over runs.

    Args:
        mean: over scenes and seeds; may be infinite (PSNR of equal images).
        spread: sample standard deviation over seeds of the mean over scenes; None for a single seed or an
            infinite mean.
        half: half width of the confidence interval of the mean over seeds; None for fewer than
            `ENOUGH_PAIRS` seeds.
    """

    mean: float
    spread: float | None
    half: float | None = None

    def text(self, decimals: int, *, spread: bool) -> str:
        """Return for example `21.91 ± 0.03`, or only the mean if there is no spread or it is not wanted."""
        mean = f"{self.mean:,.{decimals}f}"
        if self.spread is None or not spread:
            return mean
        return f"{mean} ± {self.spread:,.{decimals}f}"


def columns(plan: Plan, results: Results) -> list[Column]:
    """Return the metrics and counts that at least one run has."""
    directions = {
        item.name: getattr(item.offer.component, "higher_is_better", None)
        for run in plan.runs
        for item in run.pipeline.items["metrics"]
    }
    names = dict.fromkeys(name for found in results.values() for name in found.get("test", {}))
    # Only `avge`, an error, is computed without a metric in the pipeline.
    found = [Column(name, name, directions.get(name, False)) for name in names]
    found += [Column(key, heading, None) for key, heading in COUNTS.items()]
    return [
        column
        for column in found
        if any(value(run, column) is not None for run in results.values() if run)
    ]


def metric_columns(plan: Plan, results: Results) -> list[Column]:
    """Return the columns that have a better direction."""
    return [c for c in columns(plan, results) if c.higher_is_better is not None]


def value(results: Mapping[str, Any], column: Column) -> float | None:
    """Return the number of one run; None if it has none."""
    if column.key in COUNTS:
        number = results.get(column.key)
        return None if number is None else float(number)
    score = score_of(results, "test", column.key) if "test" in results else None
    return None if score is None else float(score)


def runs_of(
    values: Mapping[PlannedRun, Value], combination: Combination, scene: str | None = None
) -> dict[PlannedRun, Value]:
    """Return the entries of a combination, on all scenes or on one."""
    return {
        run: found
        for run, found in values.items()
        if run.combination == combination and scene in (None, run.scene)
    }


def figure(
    results: Results, combination: Combination, column: Column, scene: str | None = None
) -> Figure | None:
    """Return the mean of a combination over all scenes or on one; None if a number is missing."""
    by_seed: dict[int, list[float]] = {}
    for run, found in runs_of(results, combination, scene).items():
        number = value(found, column)
        if number is None:
            return None
        by_seed.setdefault(run.seed, []).append(number)
    return figure_of(by_seed)


def figure_of(by_seed: Mapping[int, Sequence[float]]) -> Figure | None:
    """Return the mean and spread of the numbers of each seed, one per scene; None without numbers."""
    if not by_seed:
        return None
    means = [sum(numbers) / len(numbers) for numbers in by_seed.values()]
    mean = sum(means) / len(means)
    if not math.isfinite(mean):
        return Figure(mean, None)
    return Figure(mean, statistics.stdev(means) if len(means) > 1 else None, half_width(means))


def half_width(numbers: Sequence[float]) -> float | None:
    """Return the half width of the mean's confidence interval by Student's t; None for too few numbers."""
    if len(numbers) < ENOUGH_PAIRS:
        return None
    from scipy.stats import t as student  # type: ignore[attr-defined]  # missing in its stubs

    quantile = float(student.ppf((1 + CONFIDENCE) / 2, len(numbers) - 1))
    return quantile * statistics.stdev(numbers) / math.sqrt(len(numbers))


def equal_combinations(
    plan: Plan, results: Results, scene: str | None = None
) -> list[list[Combination]]:
    """Return groups of combinations whose finished runs have equal hashes, on all scenes or on one."""
    groups: dict[tuple[str, ...], list[Combination]] = {}
    for combination in plan.combinations:
        own = runs_of(results, combination, scene).values()
        hashes = tuple(str(found.get("hash", "")) for found in own)
        if all(hashes):
            groups.setdefault(hashes, []).append(combination)
    return [group for group in groups.values() if len(group) > 1]


def unavailable(results: Results) -> dict[str, str]:
    """Return the reason for each metric without a score."""
    return {
        name: reason
        for found in results.values()
        for name, reason in found.get("unavailable", {}).items()
    }


def decimals(column: Column, figures: Iterable[Figure | None]) -> int:
    """Return the decimals for a column: 0 for counts, 1 for times, 2 for dB, 4 for scores near 1."""
    if column.key in COUNTS:
        return 0 if column.key in ("gaussians", "peak_memory_mb") else 1
    means = [abs(found.mean) for found in figures if found is not None]
    return 4 if means and max(means) < 2 else 2


def best_of(column: Column, means: Sequence[float | None]) -> list[bool]:
    """Mark the best means of a column; none if there are fewer than two or no direction is better."""
    known = [mean for mean in means if mean is not None]
    if column.higher_is_better is None or len(known) < 2:
        return [False] * len(means)
    best = max(known) if column.higher_is_better else min(known)
    return [mean == best for mean in means]


@dataclass(frozen=True)
class Difference:
    """A mean difference over pairs.

    Args:
        mean: over the pairs.
        half: see `half_width`.
    """

    mean: float
    half: float | None

    def text(self, decimals: int = 2) -> str:
        """Return for example `+0.31 ± 0.08`, or only the mean without an interval."""
        mean = f"{round(self.mean, decimals) + 0.0:+.{decimals}f}"  # no "-0.00"
        return mean if self.half is None else f"{mean} ± {self.half:.{decimals}f}"


def difference(values: Mapping[Pair, float], baseline: Mapping[Pair, float]) -> Difference | None:
    """Return the mean difference over common keys, such as scene and seed; None without any."""
    pairs = [value - baseline[key] for key, value in values.items() if key in baseline]
    if not pairs:
        return None
    return Difference(statistics.mean(pairs), half_width(pairs))
