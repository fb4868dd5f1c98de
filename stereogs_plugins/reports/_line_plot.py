"""Line plots as inline SVG: what a page needs to be read without a script or another file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

Points = Sequence[tuple[float, float]]

_COLORS = ("#3069b0", "#c8553d", "#2e8b57", "#8d5fb4", "#b8860b", "#3d9aa8", "#777777")
_WIDTH, _HEIGHT = 400, 220
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 12, 10, 26
_DECADES = 2.0
"""Positive values that span more powers of ten than this get a logarithmic axis."""


def line_plot(title: str, lines: Mapping[str, Points]) -> str:
    """A figure with a line for each label over iterations; empty if there is nothing to draw.

    Args:
        lines: (iteration, value) in order, all finite, by label.
    """
    lines = {label: points for label, points in lines.items() if points}
    if not lines:
        return ""
    values = [value for points in lines.values() for _, value in points]
    logarithmic = min(values) > 0 and math.log10(max(values) / min(values)) > _DECADES
    scale = math.log10 if logarithmic else float
    lowest = -math.inf if logarithmic else 0.0
    low, high = _range(scale(min(values)), scale(max(values)), lowest)
    last = max(x for points in lines.values() for x, _ in points)
    drawn = [_rules(low, high, logarithmic), _iterations(last)]
    for points, color in zip(lines.values(), _cycled(len(lines)), strict=True):
        path = " ".join(
            f"{_across(x, last):.1f},{_up((scale(y) - low) / (high - low)):.1f}" for x, y in points
        )
        drawn.append(f'<polyline points="{path}" stroke="{color}"/>')
        if len(points) == 1:
            x, y = path.split(",")
            drawn.append(f'<circle cx="{x}" cy="{y}" r="3" fill="{color}"/>')
    note = " (logarithmic)" if logarithmic else ""
    return (
        f'<figure class="plot"><figcaption>{escape(title)}{note}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(title)}">'
        f"{''.join(drawn)}</svg>{_legend(list(lines))}</figure>"
    )


def _range(low: float, high: float, lowest: float) -> tuple[float, float]:
    """A little more than the data, but nothing below `lowest` if the data stay above it."""
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return (low - margin if low < lowest else max(low - margin, lowest)), high + margin


def _ticks(low: float, high: float, smallest_step: float) -> list[float]:
    """Round numbers between the two, about five."""
    rough = max((high - low) / 5, smallest_step)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _across(iteration: float, last: float) -> float:
    return _LEFT + (_WIDTH - _LEFT - _RIGHT) * iteration / max(last, 1)


def _up(share: float) -> float:
    return _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * share


def _rules(low: float, high: float, logarithmic: bool) -> str:
    parts = []
    for tick in _ticks(low, high, smallest_step=1.0 if logarithmic else 0.0):
        y = _up((tick - low) / (high - low))
        parts.append(
            f'<line class="rule" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text x="{_LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">'
            f"{_number(10**tick if logarithmic else tick)}</text>"
        )
    return "".join(parts)


def _iterations(last: float) -> str:
    return "".join(
        f'<text x="{_across(share * last, last):.1f}" y="{_HEIGHT - 8}" text-anchor="{anchor}">'
        f"{share * last:,.0f}</text>"
        for share, anchor in ((0, "middle"), (0.5, "middle"), (1, "end"))
    )


def _number(value: float) -> str:
    return f"{value:,.0f}" if 1000 <= abs(value) < 1e7 else f"{value:.5g}"


def _cycled(count: int) -> list[str]:
    return [_COLORS[index % len(_COLORS)] for index in range(count)]


def _legend(labels: Sequence[str]) -> str:
    if len(labels) < 2:
        return ""
    items = (
        f'<li><span style="background:{color}"></span>{escape(label)}</li>'
        for label, color in zip(labels, _cycled(len(labels)), strict=True)
    )
    return f"<ul>{''.join(items)}</ul>"
