"""Time against error as a picture: one point for each setting, one colour for each switch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

NO_ERROR = 5e-9
"""Error at which a point without error is drawn."""
CROWD = 1.5
"""Points up to this time ratio are close together; their labels get a separate column."""
LABEL_COLUMN = 0.72
"""Time ratio at the end of that column."""
LINEAR = 0.15
"""Logarithm of the ratio at which the time axis changes from linear to logarithmic."""
LINE_HEIGHT = 2.1
"""Factor of error between two labels."""

Point = tuple[float, float, str, str]
"""Time ratio, error, label, colour."""


def draw(scene: dict[str, Any], title: str, path: Path) -> None:
    """Write the picture of one scene's rows."""
    figure = Figure(figsize=(9, 6.2), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.set_xscale("function", functions=(_spread, _gather))
    axes.set(yscale="log", xlim=(_gather(np.array(-4.1)), 40), ylim=(NO_ERROR / 2.5, 0.5))
    axes.axvline(1, color="0.75", linewidth=1, zorder=0)
    ticks = (0.8, 0.9, 1, 1.1, 1.25, 1.5, 2, 4, 8, 16)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_yticks(
        [NO_ERROR, *(10.0**power for power in range(-8, 0))],
        ["none", *(f"$10^{{{power}}}$" for power in range(-8, 0))],
    )
    axes.grid(alpha=0.25)
    axes.set_xlabel("time of forward and backward pass, over the default's")
    axes.set_ylabel("error of the image: 99.9th percentile over the largest colour")
    axes.set_title(title)
    points = _points(scene, axes)
    _label_crowd(axes, [point for point in points if point[0] <= CROWD])
    roomy = sorted(point for point in points if point[0] > CROWD)
    for number, (time, error, label, color) in enumerate(roomy):
        axes.annotate(
            label,
            (time, error),
            (8, -16 if number % 2 else 8),  # above and below in turns
            textcoords="offset points",
            fontsize=9,
            ha="right",
            color=color,
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _spread(ratios: NDArray[np.float64]) -> NDArray[np.float64]:
    """The time axis: stretched around 1, where most settings are, logarithmic far away."""
    return np.arcsinh(np.log(np.maximum(ratios, 1e-6)) / LINEAR)


def _gather(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of `_spread`."""
    return np.exp(LINEAR * np.sinh(positions))


def _points(scene: dict[str, Any], axes: Axes) -> list[Point]:
    """Draw each switch as a line through its settings; return the points to label."""
    points: list[Point] = []
    names = list(dict.fromkeys(row["switch"] for row in scene["rows"]))
    for number, name in enumerate(names):
        color = f"C{number}"
        rows = [row for row in scene["rows"] if row["switch"] == name]
        times = [row["time_ratio"] for row in rows]
        errors = [max(row["image_999"], NO_ERROR) for row in rows]
        axes.plot(times, errors, color=color, alpha=0.5, linewidth=1)
        # The default gets a point if another setting is more exact.
        improvable = min(row["image_999"] for row in rows)
        for row, time, error in zip(rows, times, errors, strict=True):
            if row["default"] and row["image_999"] <= 1.5 * improvable:
                continue
            face = "white" if row["default"] else color
            axes.plot(time, error, "o", color=color, markerfacecolor=face, markersize=6)
            suffix = " (default)" if row["default"] else ""
            points.append((time, error, f"{name}: {row['setting']}{suffix}", color))
    return points


def _label_crowd(axes: Axes, points: list[Point]) -> None:
    """Put labels in a column on the left, in the order of errors, each with a thin line."""
    height = float("inf")
    for time, error, label, color in sorted(points, key=lambda point: (-point[1], point[0])):
        height = min(height / LINE_HEIGHT, error * LINE_HEIGHT)
        axes.annotate(
            label,
            (time, error),
            (LABEL_COLUMN, height),
            ha="right",
            va="center",
            fontsize=9,
            color=color,
            arrowprops={"arrowstyle": "-", "color": color, "alpha": 0.4, "linewidth": 0.7},
        )
