"""Inline SVG: a metric against a varied value, a line for each choice of everything else."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from . import scores
from .plan import Combination, Plan
from .scores import Column, Figure, Results

_COLORS = ("#3b6fb6", "#c4572e", "#2f8a57", "#8a5bb0", "#b08a1e", "#4a9aa5", "#a83f6f", "#6b6b6b")
_WIDTH, _HEIGHT = 420.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 14.0, 14.0, 40.0
_TICKS = 4


@dataclass(frozen=True)
class Line:
    """One line of a plot.

    Args:
        label: what stays the same along it; empty if there is nothing else.
        points: index of the varied value, and the figure there.
    """

    label: str
    points: tuple[tuple[int, Figure], ...]


def plots(plan: Plan, results: Results) -> Iterator[str]:
    """A figure for each variation of two values or more and each metric."""
    metrics = [c for c in scores.columns(plan, results) if c.higher_is_better is not None]
    for axis, variation in enumerate(plan.variations):
        if len(variation.choices) < 2:
            continue
        for column in metrics:
            lines = _lines(plan, results, axis, column)
            if lines:
                yield _figure(plan, axis, column, lines)


def _lines(plan: Plan, results: Results, axis: int, column: Column) -> list[Line]:
    choices = plan.variations[axis].choices
    groups: dict[str, list[tuple[int, Figure]]] = {}
    for combination in plan.combinations:
        choice = combination.choices[axis]
        found = scores.figure(results, combination, column)
        if choice is not None and found is not None and math.isfinite(found.mean):
            label = _others(plan, combination, axis)
            groups.setdefault(label, []).append((choices.index(choice), found))
    return [Line(label, tuple(points)) for label, points in groups.items()]


def _others(plan: Plan, combination: Combination, axis: int) -> str:
    """Everything that a combination has chosen but the value on the axis."""
    rest = tuple(None if i == axis else c for i, c in enumerate(combination.choices))
    return plan.describe(Combination(combination.on, rest))


def _figure(plan: Plan, axis: int, column: Column, lines: Sequence[Line]) -> str:
    variation = plan.variations[axis]
    xs = _positions([choice.number for choice in variation.choices])
    low, high = _range(lines)
    body = list(_vertical_axis(low, high))
    for choice, x in zip(variation.choices, xs, strict=True):
        body.append(
            f'<text class="tick" x="{x:.1f}" y="{_HEIGHT - _BOTTOM + 16:.1f}" '
            f'text-anchor="middle">{escape(choice.label)}</text>'
        )
    body.append(
        f'<text class="axis" x="{(_LEFT + _WIDTH - _RIGHT) / 2:.1f}" y="{_HEIGHT - 6:.1f}" '
        f'text-anchor="middle">{escape(variation.name)}</text>'
    )
    for line, color in zip(lines, _cycle(len(lines)), strict=True):
        body += _drawn(line, color, xs, low, high)
    title = f"{column.heading} against {variation.name}"
    legend = "".join(
        f'<li><span style="background:{color}"></span>{escape(line.label)}</li>'
        for line, color in zip(lines, _cycle(len(lines)), strict=True)
        if line.label
    )
    return (
        f'<figure class="plot"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(title)}">'
        f"{''.join(body)}</svg>{f'<ul>{legend}</ul>' if legend else ''}</figure>"
    )


def _drawn(line: Line, color: str, xs: Sequence[float], low: float, high: float) -> Iterator[str]:
    """The line, its points, and bars of one spread up and down."""
    points = sorted(line.points, key=lambda point: xs[point[0]])
    places = [(xs[index], _y(figure.mean, low, high), figure) for index, figure in points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
    yield f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>'
    for x, y, figure in places:
        if figure.spread is not None:
            top = _y(figure.mean + figure.spread, low, high)
            bottom = _y(figure.mean - figure.spread, low, high)
            yield (
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top:.1f}" y2="{bottom:.1f}" '
                f'stroke="{color}"/>'
            )
        yield (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{color}">'
            f"<title>{figure.mean:.4f}</title></circle>"
        )


def _vertical_axis(low: float, high: float) -> Iterator[str]:
    places = 2 if high - low > 0.2 else 4
    for tick in range(_TICKS + 1):
        number = low + (high - low) * tick / _TICKS
        y = _y(number, low, high)
        yield (
            f'<line class="grid" x1="{_LEFT:.1f}" x2="{_WIDTH - _RIGHT:.1f}" '
            f'y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text class="tick" x="{_LEFT - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">'
            f"{number:.{places}f}</text>"
        )


def _positions(numbers: Sequence[float | None]) -> list[float]:
    """Horizontal places: true to scale for different numbers, evenly spaced for names."""
    margin, width = 18.0, _WIDTH - _LEFT - _RIGHT
    values = [number for number in numbers if number is not None]
    if len(set(values)) < len(numbers):
        values = [float(index) for index in range(len(numbers))]
    low, high = min(values), max(values)
    return [_LEFT + margin + (width - 2 * margin) * (v - low) / (high - low) for v in values]


def _range(lines: Sequence[Line]) -> tuple[float, float]:
    figures = [figure for line in lines for _, figure in line.points]
    low = min(figure.mean - (figure.spread or 0) for figure in figures)
    high = max(figure.mean + (figure.spread or 0) for figure in figures)
    margin = 0.08 * (high - low) or 0.5
    return low - margin, high + margin


def _y(number: float, low: float, high: float) -> float:
    return _TOP + (_HEIGHT - _TOP - _BOTTOM) * (high - number) / (high - low)


def _cycle(count: int) -> list[str]:
    return [_COLORS[index % len(_COLORS)] for index in range(count)]
