"""Line plots as inline SVG, without scripts or other files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import cycle

from ..drawing.axis_ticks import multiples, round_step

_COLORS = ["#3069b0", "#c8553d", "#2e8b57", "#8d5fb4", "#b8860b", "#3d9aa8", "#a83f6f", "#777777"]
_WIDTH, _HEIGHT = 400, 220
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 12, 10, 26
_INSET = 14
"""Pixels between the outermost ticks and the frame: half of a tick's text."""
_STEPS = 5
"""About so many steps from the lowest to the highest tick of the upward axis."""
_NAME_HEIGHT = 16
_DECADES = 2.0
"""Powers of ten; positive values with a larger range get a logarithmic axis."""
_NEAR_LOWEST = 0.6
"""Share of the largest value; smaller values start the axis at its lowest."""
_MAX_MARKED = 12
"""Largest number of points that are drawn individually."""


@dataclass(frozen=True)
class Point:
    """A point at a finite x (`across`) and y (`value`); `marked` draws a ring.

    Args:
        spread: Half height of an error bar; None for no bar.
    """

    across: float
    value: float
    spread: float | None = None
    marked: bool = False


@dataclass(frozen=True)
class Line:
    """A line through points from left to right, with a label in the legend, which may be empty.

    Args:
        dashed: If True, drawn as a dashed reference line without points.
    """

    label: str
    points: Sequence[Point]
    dashed: bool = False


@dataclass(frozen=True)
class Axis:
    """A horizontal axis.

    Args:
        ticks: At least one position with its text; the plot reaches from the first to the last.
        name: Text below the ticks; may be empty.
    """

    ticks: Sequence[tuple[float, str]]
    name: str = ""


def line_plot(title: str, lines: Iterable[Line], axis: Axis) -> str:
    """Return a figure, with a legend for several lines; empty if no line has a point."""
    lines = [line for line in lines if line.points]
    if not lines:
        return ""
    across, up = _Across(axis), _Up(lines)
    height = _HEIGHT + (_NAME_HEIGHT if axis.name else 0)
    drawn = [*up.rules(), *across.texts()]
    for line, color in zip(lines, cycle(_COLORS)):
        drawn += _drawn(line, color, across, up)
    note = " (logarithmic)" if up.logarithmic else ""
    return (
        f'<figure class="plot"><figcaption>{escape(title)}{note}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escape(title)}">'
        f"{''.join(drawn)}</svg>{_legend(lines)}</figure>"
    )


class _Across:
    """The horizontal axis."""

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._first, self._last = axis.ticks[0][0], axis.ticks[-1][0]

    def __call__(self, place: float) -> float:
        share = (place - self._first) / ((self._last - self._first) or 1)
        return _LEFT + _INSET + (_WIDTH - _LEFT - _RIGHT - 2 * _INSET) * share

    def texts(self) -> Iterator[str]:
        for place, text in self._axis.ticks:
            yield _text(self(place), _HEIGHT - 8, text, "middle")
        if self._axis.name:
            middle = (_LEFT + _WIDTH - _RIGHT) / 2
            yield _text(middle, _HEIGHT - 8 + _NAME_HEIGHT, self._axis.name, "middle")


class _Up:
    """The vertical axis, logarithmic for values over several decades."""

    def __init__(self, lines: Sequence[Line]) -> None:
        ends = [
            point.value + sign * (point.spread or 0)
            for line in lines
            for point in line.points
            for sign in (-1, 1)
        ]
        low, high = min(ends), max(ends)
        self.logarithmic = low > 0 and math.log10(high / low) > _DECADES
        self._scale = math.log10 if self.logarithmic else float
        lowest = -math.inf if self.logarithmic else 0.0
        self._low, self._high = _range(self._scale(low), self._scale(high), lowest)

    def __call__(self, value: float) -> float:
        return self._at(self._scale(value))

    def rules(self) -> Iterator[str]:
        """Yield grid lines at round numbers, with the numbers."""
        smallest = 1.0 if self.logarithmic else 0.0
        step = round_step(max((self._high - self._low) / _STEPS, smallest))
        for tick in multiples(step, self._low, self._high):
            y = self._at(tick)
            yield f'<line class="rule" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
            number = _number(10**tick if self.logarithmic else tick)
            yield _text(_LEFT - 6, y + 3.5, number, "end")

    def _at(self, scaled: float) -> float:
        share = (scaled - self._low) / (self._high - self._low)
        return _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * share


def _range(low: float, high: float, lowest: float) -> tuple[float, float]:
    """Add a margin to the range, but do not cross `lowest` unless the data do.

    If the data span a large part of the way from `lowest`, the range starts there, so that heights compare.
    """
    if lowest <= low < _NEAR_LOWEST * (high - lowest) + lowest:
        return lowest, high + 0.05 * (high - lowest)
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return (low - margin if low < lowest else max(low - margin, lowest)), high + margin


def _drawn(line: Line, color: str, across: _Across, up: _Up) -> Iterator[str]:
    """Yield the line, its error bars, and its points if they are few."""
    places = [(across(point.across), up(point.value), point) for point in line.points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
    dashes = ' stroke-dasharray="5 4"' if line.dashed else ""
    yield f'<polyline points="{path}" stroke="{color}"{dashes}/>'
    for x, y, point in places:
        if point.spread is not None:
            top, bottom = up(point.value + point.spread), up(point.value - point.spread)
            ends = f'x1="{x:.1f}" x2="{x:.1f}" y1="{top:.1f}" y2="{bottom:.1f}"'
            yield f'<line {ends} stroke="{color}"/>'
        if point.marked:
            yield f'<circle class="mark" cx="{x:.1f}" cy="{y:.1f}" r="6.5" stroke="{color}"/>'
        if len(places) <= _MAX_MARKED and not line.dashed:
            hint = f"<title>{_number(point.value)}</title>"
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{color}">{hint}</circle>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _number(value: float) -> str:
    return f"{value:,.0f}" if 1000 <= abs(value) < 1e7 else f"{value:.5g}"


def _legend(lines: Sequence[Line]) -> str:
    if len(lines) < 2:
        return ""
    items = (
        f'<li><span style="background:{color}"></span>{escape(line.label)}</li>'
        for line, color in zip(lines, cycle(_COLORS))
    )
    return f"<ul>{''.join(items)}</ul>"
