"""The results as an HTML page without other files: tables, plots, renders and depths."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from registry.runs.results import RENDERS
from registry.toolkit.web_page import (
    Axis,
    Line,
    Point,
    grid,
    line_plot,
    note,
    page,
    section,
)

from ..planning.plan import Combination, Plan
from ..running.folder import ExperimentFolder
from . import scores
from .against_time import Reference, against_time, read_curves
from .scores import Column, Results
from .table import notes, tables
from .view_gallery import RenderedRun, view_gallery, view_wipes


def as_page(
    plan: Plan, results: Results, folder: ExperimentFolder, references: Sequence[Reference] = ()
) -> str:
    """Return the page, with images of the first seed, and published scores next to the curves."""
    curves = read_curves(results, folder) if plan.kind == "bench" else {}
    contents = [
        note(
            f"{plan.size}. Bold: the best of a column. seconds: time of training; in all: time of the "
            "whole run."
        ),
        *(table.html() for table in tables(plan, results)),
        *(note(line) for line in notes(plan, results)),
        section("Scores against time", against_time(plan, results, curves, references)),
        section("Plots", grid(list(plots(plan, results)))),
        *(section(scene, _images(plan, results, folder, scene)) for scene in plan.scenes),
    ]
    return page(f"{plan.kind.capitalize()}: {plan.name}", contents)


def _images(plan: Plan, results: Results, folder: ExperimentFolder, scene: str) -> str:
    """Return the photograph, renders and depths of each test view.

    A bench shows renders over the photograph with a slider; an ablation, whose renders differ little, shows
    all at once.
    """
    shown = view_wipes if plan.kind == "bench" else view_gallery
    return shown(
        [
            RenderedRun(
                plan.describe(run.combination),
                folder.run(run).path / RENDERS,
                found.get("views", {}).get("test", {}),
            )
            for run, found in results.items()
            if run.scene == scene and run.seed == plan.seeds[0]
        ]
    )


def plots(plan: Plan, results: Results) -> Iterator[str]:
    """Yield a figure of each metric against each number that varies, with a line per choice of the rest.

    Other choices, such as pipelines, have no order that a line could follow; the tables compare them.
    """
    for index, variation in enumerate(plan.variations):
        places = [choice.number for choice in variation.choices if choice.number is not None]
        if len(places) < 2 or len(set(places)) < len(variation.choices):
            continue
        ticks = zip(places, (choice.label for choice in variation.choices), strict=True)
        axis = Axis(sorted(ticks), variation.name)
        for column in scores.metric_columns(plan, results):
            lines = _lines(plan, results, index, places, column)
            plot = line_plot(f"{column.heading} against {variation.name}", lines, axis)
            if plot:
                yield plot


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
            rest = tuple(None if i == index else c for i, c in enumerate(combination.choices))
            label = plan.describe(Combination(combination.on, rest))
            groups.setdefault(label, []).append(point)
    return [
        Line(label, sorted(points, key=lambda point: point.across))
        for label, points in groups.items()
    ]
