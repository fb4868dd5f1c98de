"""What each row gains over the first, as means of differences between runs of one scene and seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..planning.plan import Combination, Plan
from . import scores
from .paired import CONFIDENCE, ENOUGH_PAIRS, difference
from .scores import NONE, Column, Results


@dataclass(frozen=True)
class Differences:
    """A table.

    Args:
        title: above it.
        note: what must be known beside the numbers.
        headings: of the differences.
        rows: of each combination, in the plan's order, a text for each heading; the first has dashes.
    """

    title: str
    note: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


def differences(plan: Plan, results: Results) -> Differences | None:
    """Each metric's differences over all scenes, then the first metric's in each of several.

    None where a row has too few pairs for an interval, or there is nothing to compare.
    """
    metrics = [c for c in scores.columns(plan, results) if c.key not in scores.COUNTS]
    pairs = len(plan.scenes) * len(plan.seeds)
    if pairs < ENOUGH_PAIRS or len(plan.combinations) < 2 or not metrics:
        return None
    asked: list[tuple[Column, str | None]] = [(metric, None) for metric in metrics]
    if len(plan.scenes) > 1:
        asked += [(metrics[0], scene) for scene in plan.scenes]
    columns = [_column(plan, results, metric, scene) for metric, scene in asked]
    return Differences(
        f"differences to {plan.describe(plan.combinations[0])}",
        f"± of differences: their {CONFIDENCE:.0%} interval (Student's t) over the pairs of scene and seed",
        [metric.heading if scene is None else scene for metric, scene in asked],
        list(zip(*columns, strict=True)),
    )


def _column(plan: Plan, results: Results, metric: Column, scene: str | None) -> list[str]:
    places = scores.decimals(
        metric, [scores.figure(results, row, metric, scene) for row in plan.combinations]
    )
    first, *others = (_numbers(results, row, metric, scene) for row in plan.combinations)
    found = [difference(numbers, first) for numbers in others]
    return [NONE, *(NONE if one is None else one.text(places) for one in found)]


def _numbers(
    results: Results, combination: Combination, metric: Column, scene: str | None
) -> dict[tuple[str, int], float]:
    """A combination's finite numbers, by scene and seed; none while a run is missing."""
    done, planned = scores.finished(results, combination, scene)
    if done < planned:
        return {}
    numbers = {
        (run.scene, run.seed): scores.value(found, metric)
        for run, found in results.items()
        if run.combination == combination and scene in (None, run.scene)
    }
    return {key: n for key, n in numbers.items() if n is not None and math.isfinite(n)}
