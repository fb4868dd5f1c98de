"""Which of the numbers in metrics.jsonl share a plot."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from registry.web_page import Axis, Line, Point, line_plot

_GROUPS = (
    ("Loss", re.compile(r"loss|photometric")),
    ("Test: {}", re.compile(r"test (.+)")),
    ("Gaussians", re.compile(r"gaussians")),
    ("Loss terms of regularizers", re.compile(r"regularizers\.(.+)")),
    ("Gradient of opacities: quantiles, %", re.compile(r"opacity_gradient_q(\d+)")),
    ("The same over its mean: quantiles, %", re.compile(r"opacity_beta_q(\d+)")),
    ("Stereo: share of pixels", re.compile(r".+_(?:valid|occluded)")),
    ("Stereo: calls so far", re.compile(r".+_(?:inferences|reused|skipped)")),
)
"""Title, and the names that it holds; a title with {} is one plot for each name."""
_NO_PLOT = ("iteration", "seconds")


def training_plots(metrics: Sequence[dict[str, Any]]) -> list[str]:
    """Figures of everything that the lines of metrics.jsonl tell; unknown names get one each."""
    plots: dict[tuple[int, str], list[Line]] = {}
    for name, points in _by_name(metrics).items():
        place, label = _place(name)
        plots.setdefault(place, []).append(Line(label, points))
    ordered = sorted(plots.items(), key=lambda plot: plot[0])
    return [line_plot(title, lines, _axis(lines)) for (_, title), lines in ordered]


def _axis(lines: Sequence[Line]) -> Axis:
    """Iterations from 0 to the last that was logged."""
    last = max(point.across for line in lines for point in line.points)
    return Axis([(place, f"{place:,.0f}") for place in (0, last / 2, last)])


def _by_name(metrics: Sequence[dict[str, Any]]) -> dict[str, list[Point]]:
    found: dict[str, list[Point]] = {}
    for line in metrics:
        scores = line.get("test", {})
        for name, value in {**line, **{f"test {k}": v for k, v in scores.items()}}.items():
            number = isinstance(value, int | float) and math.isfinite(value)
            if number and name not in _NO_PLOT and "iteration" in line:
                found.setdefault(name, []).append(Point(line["iteration"], float(value)))
    return found


def _place(name: str) -> tuple[tuple[int, str], str]:
    """The order and title of a name's plot, and the name's label in it."""
    for order, (title, pattern) in enumerate(_GROUPS):
        match = pattern.fullmatch(name)
        if match:
            label = match[1] if pattern.groups else name
            return (order, title.format(label)), label
    return (len(_GROUPS), name), name
