"""Test scores against time: curves with the Pareto front, and tables at equal time.

Time is the sum of loading, initialization and training; scores during training, final scores and exports are
not included.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from registry.runs.folder import METRICS
from registry.toolkit.web_page import Axis, Cell, Line, Point, grid, line_plot, note, score_table

from ..comparing.paper_tables import PaperTables, paper_names, paper_tables
from ..planning.plan import Combination, Plan, PlannedRun
from ..running.folder import ExperimentFolder
from . import scores
from .scores import NONE, Column, Figure, Results, figure_of, runs_of

MOMENTS = (5, 20, 120)
"""Seconds of the tables at equal time."""
_TICKS = [step * 10**power for power in range(-1, 5) for step in (1, 2, 5)]

_CURVES_NOTE = (
    "Time of loading, initialization and training on this machine; the axis is logarithmic. "
    "Rings mark the Pareto front: no other point is as good in less time."
)
_TABLES_NOTE = (
    "The last scores up to each time. An unfinished run scores lower than a run of that length, because "
    "its learning rates have not decayed yet."
)


@dataclass(frozen=True)
class Reference:
    """A published row: a label with method, source, time and hardware, and a number per metric."""

    label: str
    numbers: Mapping[str, float]


def published_costs(plan: Plan) -> list[Reference]:
    """Return published rows with known time for the protocol of all runs; none without a common protocol."""
    followed = [run.pipeline.protocol for run in plan.runs]
    names = {None if p is None or p.modified else p.protocol.name for p in followed}
    (protocol,) = names if len(names) == 1 else (None,)
    if protocol is None:
        return []
    return [row for name in paper_names() for row in _references(paper_tables(name), protocol)]


def _references(tables: PaperTables, protocol: str) -> Iterator[Reference]:
    for method, cost in tables.overhead.get(protocol, {}).items():
        numbers = tables.results.get(protocol, {}).get(method)
        if numbers is not None:
            where = f" on {tables.hardware}" if tables.hardware else ""
            label = f"{tables.methods[method]}, published: {cost.minutes:g} min{where}"
            yield Reference(label, dict(zip(tables.metrics, numbers, strict=True)))


def against_time(
    plan: Plan, results: Results, curves: Curves, references: Sequence[Reference] = ()
) -> str:
    """Return the section; empty if no run has scores."""
    metrics = scores.metric_columns(plan, results)
    plots = [
        plot
        for scene in plan.scenes
        for column in metrics
        if (plot := _plot(plan, curves, scene, column, references))
    ]
    if not plots:
        return ""
    tables = "".join(_table(plan, curves, column) for column in metrics)
    return note(_CURVES_NOTE) + grid(plots) + tables + note(_TABLES_NOTE)


def _plot(
    plan: Plan, curves: Curves, scene: str, column: Column, references: Sequence[Reference]
) -> str:
    """Plot a metric on a scene with a line per combination."""
    samples = {
        plan.describe(combination): curve(curves, combination, scene, column.key)
        for combination in plan.combinations
    }
    everything = [sample for line in samples.values() for sample in line]
    if not everything:
        return ""
    best = front(everything, higher_is_better=bool(column.higher_is_better))
    axis = _axis([sample.seconds for sample in everything])
    lines = [Line(label, [_point(s, s in best) for s in found]) for label, found in samples.items()]
    ends = (axis.ticks[0][0], axis.ticks[-1][0])
    for reference in references:
        if column.key in reference.numbers:
            points = [Point(end, reference.numbers[column.key]) for end in ends]
            lines.append(Line(reference.label, points, dashed=True))
    return line_plot(f"{scene}: {column.heading} against seconds", lines, axis)


def _point(sample: Sample, marked: bool) -> Point:
    return Point(math.log10(max(sample.seconds, 0.1)), sample.value, sample.spread, marked)


def _axis(seconds: Sequence[float]) -> Axis:
    low, high = min(seconds), max(seconds)
    first = max((tick for tick in _TICKS if tick <= low), default=_TICKS[0])
    last = min((tick for tick in _TICKS if tick >= high), default=_TICKS[-1])
    ticks = [tick for tick in _TICKS if first <= tick <= last]
    return Axis([(math.log10(tick), f"{tick:g}") for tick in ticks], "seconds")


def _table(plan: Plan, curves: Curves, column: Column) -> str:
    """Return a table of the scores of each combination at each moment, averaged over scenes."""
    columns = [
        [reached(curves, combination, column.key, moment) for combination in plan.combinations]
        for moment in MOMENTS
    ]
    figures = [found for one in columns for found in one]
    if not any(figures):
        return ""
    decimals = scores.decimals(column, figures)
    rows = [[Cell(plan.describe(combination))] for combination in plan.combinations]
    for found in columns:
        best = scores.best_of(column, [figure.mean if figure else None for figure in found])
        for row, figure, strong in zip(rows, found, best, strict=True):
            text = NONE if figure is None else figure.text(decimals, spread=True)
            row.append(Cell(text, strong))
    head = [column.heading_with_arrow, *(f"at {moment} s" for moment in MOMENTS)]
    return score_table(head, rows, caption=f"{column.heading} at equal time")


@dataclass(frozen=True)
class Sample:
    """A score at a time, averaged over seeds.

    Args:
        seconds: since the start of the run.
        value: of the metric.
        spread: sample standard deviation over seeds; None for one seed.
    """

    seconds: float
    value: float
    spread: float | None = None


Samples = Sequence[tuple[int, float, Mapping[str, float | None]]]
"""Iteration, seconds, and mean of each metric over the test views, in order."""
Curves = Mapping[PlannedRun, Samples]


def read_curves(results: Results, folder: ExperimentFolder) -> Curves:
    """Return the scores during training and at the end of each finished run."""
    return {run: _curve(found, folder, run) for run, found in results.items() if found}


def _curve(found: Mapping[str, Any], folder: ExperimentFolder, run: PlannedRun) -> Samples:
    stages = found.get("stages", {})
    before = stages.get("scene", 0.0) + stages.get("initialization", 0.0)
    file = folder.run(run).path / METRICS
    text = file.read_text("utf-8") if file.is_file() else ""
    # The last line may be incomplete after a power failure.
    whole = (line for line in text.splitlines() if line.startswith("{") and line.endswith("}"))
    end = int(found.get("iterations", 0))
    curve = [
        (int(line["iteration"]), before + float(line["seconds"]), line["test"])
        for line in map(json.loads, whole)
        if {"iteration", "seconds", "test"} <= {*line} and line["iteration"] < end
    ]
    missing = found.get("unavailable", {})
    last = {name: score for name, score in found.get("test", {}).items() if name not in missing}
    return [*curve, (end, before + float(found.get("seconds", 0.0)), last)]


def curve(curves: Curves, combination: Combination, scene: str, metric: str) -> list[Sample]:
    """Return the samples of a combination on a scene, at the iterations that all seeds have scored."""
    by_iteration: dict[int, list[tuple[float, float]]] = {}
    own = runs_of(curves, combination, scene)
    for samples in own.values():
        for iteration, seconds, means in samples:
            value = means.get(metric)
            if value is not None and math.isfinite(value):
                by_iteration.setdefault(iteration, []).append((seconds, value))
    return [_sample(found) for _, found in sorted(by_iteration.items()) if len(found) == len(own)]


def _sample(found: Sequence[tuple[float, float]]) -> Sample:
    values = [value for _, value in found]
    return Sample(
        statistics.fmean(seconds for seconds, _ in found),
        statistics.fmean(values),
        statistics.stdev(values) if len(values) > 1 else None,
    )


def reached(curves: Curves, combination: Combination, metric: str, seconds: float) -> Figure | None:
    """Return the last score before a time, over scenes and seeds; None if a run has none yet."""
    by_seed: dict[int, list[float]] = {}
    for run, samples in runs_of(curves, combination).items():
        known = [means.get(metric) for _, after, means in samples if after <= seconds]
        finite = [value for value in known if value is not None and math.isfinite(value)]
        if not finite:
            return None
        by_seed.setdefault(run.seed, []).append(finite[-1])
    return figure_of(by_seed)


def front(samples: Iterable[Sample], *, higher_is_better: bool) -> set[Sample]:
    """Return the Pareto front: samples for which no other is as good and as fast."""
    sign = 1 if higher_is_better else -1
    best, kept = -math.inf, set()
    for sample in sorted(samples, key=lambda s: (s.seconds, -sign * s.value)):
        if sign * sample.value > best:
            best = sign * sample.value
            kept.add(sample)
    return kept
