"""Plots of the values in metrics.jsonl."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from registry.toolkit.web_page import Axis, Line, Point, folded, grid, line_plot

from .scores import with_unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_GROUPS = (
    ("Loss", re.compile(r"loss|photometric")),
    ("Held-out photographs: {}", re.compile(r"test (.+)")),
    ("Gaussians", re.compile(r"gaussians")),
    ("Loss terms of regularizers", re.compile(r"regularizers\.(.+)")),
    ("Gradient of opacities: quantiles, %", re.compile(r"opacity_gradient_q(\d+)")),
    ("Gradient of opacities over its mean: quantiles, %", re.compile(r"opacity_beta_q(\d+)")),
    ("Stereo: share of pixels", re.compile(r".+_(?:valid|occluded)")),
    ("Stereo: number of calls", re.compile(r".+_(?:inferences|reused|skipped)")),
)
"""Title of a plot, and its values by name; a title with {} makes one plot per name."""
_MAIN = 4
"""Number of groups that are not folded."""
_NO_PLOT = ("iteration", "seconds")
_FEWEST = 3
"""Points of a curve, at least."""


def training_plots(metrics: Sequence[Mapping[str, Any]], results: Mapping[str, Any]) -> str:
    """Plot the values of metrics.jsonl that change, the less common ones folded.

    Args:
        metrics: lines of metrics.jsonl.
        results: results.json; its test scores are the last points of their curves.
    """
    end = {"iteration": results.get("iterations", 0), "test": results["test"]}
    lines = [*metrics, end] if metrics else []
    plots: dict[tuple[int, str], list[Line]] = {}
    for name, points in _curves(lines).items():
        place, label = _place(name)
        plots.setdefault(place, []).append(Line(label, points))
    ordered = sorted(plots.items(), key=lambda plot: plot[0])
    axis = _axis(lines)
    main = [line_plot(title, own, axis) for (order, title), own in ordered if order < _MAIN]
    others = [line_plot(title, own, axis) for (order, title), own in ordered[len(main) :]]
    return grid(main) + folded("other logged values", grid(others))


def _axis(lines: Sequence[Mapping[str, Any]]) -> Axis:
    """Return an axis from iteration 0 to the last, with the seconds of training."""
    seconds = {0: 0.0} | {
        line["iteration"]: line["seconds"] for line in lines if {"iteration", "seconds"} <= {*line}
    }
    last = max((line.get("iteration", 0) for line in lines), default=0)
    middle = min(seconds, key=lambda iteration: abs(iteration - last / 2))
    places = sorted({0, middle, last})
    ticks = [
        (place, f"{place:,}" + (f" ({seconds[place]:.3g} s)" if seconds.get(place) else ""))
        for place in places
    ]
    return Axis(ticks, "iterations (seconds of training)")


def _curves(metrics: Sequence[Mapping[str, Any]]) -> dict[str, list[Point]]:
    """Return the values that are worth a curve: enough points, not constant, not the same as another."""
    found: dict[str, list[Point]] = {}
    for name, points in _by_name(metrics).items():
        changes = len({point.value for point in points}) > 1
        if len(points) >= _FEWEST and changes and points not in found.values():
            found[name] = points
    return found


def _by_name(metrics: Sequence[Mapping[str, Any]]) -> dict[str, list[Point]]:
    found: dict[str, list[Point]] = {}
    for line in metrics:
        scores = line.get("test", {})
        for name, value in {**line, **{f"test {k}": v for k, v in scores.items()}}.items():
            number = isinstance(value, int | float) and math.isfinite(value)
            if number and name not in _NO_PLOT and "iteration" in line:
                points = found.setdefault(name, [])
                if not points or points[-1].across < line["iteration"]:
                    points.append(Point(line["iteration"], float(value)))
    return found


def _place(name: str) -> tuple[tuple[int, str], str]:
    """Return the order and title of a name's plot, and the name's label in it."""
    for order, (title, pattern) in enumerate(_GROUPS):
        match = pattern.fullmatch(name)
        if match:
            label = match[1] if pattern.groups else name
            return (order, title.format(with_unit(label))), label
    return (len(_GROUPS), name.replace("_", " ")), name
