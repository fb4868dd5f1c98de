"""A metric against a varied value, a line for each choice of everything else."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from registry.toolkit.web_page import Axis, Line, Point, line_plot

from ..planning.plan import Combination, Plan
from ..planning.variations import Choice
from . import scores
from .scores import Column, Results


def plots(plan: Plan, results: Results) -> Iterator[str]:
    """A figure for each variation of two values or more and each metric."""
    metrics = [c for c in scores.columns(plan, results) if c.higher_is_better is not None]
    for index, variation in enumerate(plan.variations):
        if len(variation.choices) < 2:
            continue
        places = _places(variation.choices)
        ticks = zip(places, (choice.label for choice in variation.choices), strict=True)
        axis = Axis(sorted(ticks), variation.name)
        for column in metrics:
            lines = _lines(plan, results, index, places, column)
            plot = line_plot(f"{column.heading} against {variation.name}", lines, axis)
            if plot:
                yield plot


def _places(choices: Sequence[Choice]) -> list[float]:
    """Where values stand: numbers at themselves, if all are numbers and differ, or one by one."""
    numbers = [choice.number for choice in choices if choice.number is not None]
    one_by_one = len(set(numbers)) < len(choices)
    return [float(index) for index in range(len(choices))] if one_by_one else numbers


def _lines(
    plan: Plan, results: Results, index: int, places: Sequence[float], column: Column
) -> list[Line]:
    choices = plan.variations[index].choices
    groups: dict[str, list[Point]] = {}
    for combination in plan.combinations:
        choice = combination.choices[index]
        found = scores.figure(results, combination, column)
        if choice is not None and found is not None and math.isfinite(found.mean):
            point = Point(places[choices.index(choice)], found.mean, found.spread)
            groups.setdefault(_others(plan, combination, index), []).append(point)
    return [
        Line(label, sorted(points, key=lambda point: point.across))
        for label, points in groups.items()
    ]


def _others(plan: Plan, combination: Combination, index: int) -> str:
    """Everything that a combination has chosen but the varied value."""
    rest = tuple(None if i == index else c for i, c in enumerate(combination.choices))
    return plan.describe(Combination(combination.on, rest))
