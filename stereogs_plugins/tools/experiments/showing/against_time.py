"""The part of a page that sets scores against seconds: curves with their Pareto front, equal-time tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from registry.toolkit.web_page import Axis, Cell, Line, Point, grid, line_plot, note, score_table

from ..planning.plan import Plan
from . import scores
from .samples import Curves, Sample, curve, front, reached
from .scores import NONE, Column, Figure, Results
from .table import best_of

MOMENTS = (5, 20, 120)
"""Seconds at which all are compared."""
_TICKS = [step * 10**power for power in range(-1, 5) for step in (1, 2, 5)]

_EXPLAINED = (
    "Seconds are those of loading, first points and training, on this machine; the axis is logarithmic. "
    "Rings: the Pareto front, where nothing is as good in less time."
)
_EQUAL_TIME = (
    "The last scores that were there by then. A run on its way to its end is not as good as one that was "
    "made for that time: its learning rates have not come down yet."
)


@dataclass(frozen=True)
class Reference:
    """A published row, for comparison.

    Args:
        label: method, source, and what it took on which hardware.
        numbers: by metric.
    """

    label: str
    numbers: Mapping[str, float]


def against_time(
    plan: Plan, results: Results, curves: Curves, references: Sequence[Reference] = ()
) -> str:
    """All of it, empty if no run has scores."""
    metrics = [c for c in scores.columns(plan, results) if c.higher_is_better is not None]
    plots = [
        p
        for scene in plan.scenes
        for column in metrics
        if (p := _plot(plan, curves, scene, column, references))
    ]
    if not plots:
        return ""
    tables = "".join(_table(plan, curves, column) for column in metrics)
    return note(_EXPLAINED) + grid(plots) + tables + note(_EQUAL_TIME)


def _plot(
    plan: Plan, curves: Curves, scene: str, column: Column, references: Sequence[Reference]
) -> str:
    """One metric on one scene, a line for each combination."""
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
    lines += _published(references, column.key, axis)
    return line_plot(f"{scene}: {column.heading} against seconds", lines, axis)


def _point(sample: Sample, marked: bool) -> Point:
    return Point(math.log10(max(sample.seconds, 0.1)), sample.value, sample.spread, marked)


def _axis(seconds: Sequence[float]) -> Axis:
    low, high = min(seconds), max(seconds)
    first = max((tick for tick in _TICKS if tick <= low), default=_TICKS[0])
    last = min((tick for tick in _TICKS if tick >= high), default=_TICKS[-1])
    ticks = [tick for tick in _TICKS if first <= tick <= last]
    return Axis([(math.log10(tick), f"{tick:g}") for tick in ticks], "seconds")


def _published(references: Sequence[Reference], metric: str, axis: Axis) -> Iterator[Line]:
    ends = (axis.ticks[0][0], axis.ticks[-1][0])
    for reference in references:
        if metric in reference.numbers:
            value = reference.numbers[metric]
            yield Line(reference.label, [Point(end, value) for end in ends], dashed=True)


def _table(plan: Plan, curves: Curves, column: Column) -> str:
    """What each combination had reached at each moment, a mean over the scenes."""
    columns = [
        [reached(curves, combination, column.key, moment) for combination in plan.combinations]
        for moment in MOMENTS
    ]
    figures = [found for column_ in columns for found in column_]
    if not any(figures):
        return ""
    decimals = scores.decimals(column, figures)
    best = [best_of(column, [found.mean if found else None for found in m]) for m in columns]
    rows = [
        [
            Cell(plan.describe(combination)),
            *(
                Cell(_text(found[i], decimals), strong[i])
                for found, strong in zip(columns, best, strict=True)
            ),
        ]
        for i, combination in enumerate(plan.combinations)
    ]
    arrow = "↑" if column.higher_is_better else "↓"
    head = [f"{column.heading} {arrow}", *(f"at {moment} s" for moment in MOMENTS)]
    return score_table(head, rows, caption=f"{column.heading} at equal time")


def _text(found: Figure | None, decimals: int) -> str:
    return NONE if found is None else found.text(decimals, spread=True)
