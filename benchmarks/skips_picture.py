"""PSNR against CPU seconds of each switch as a picture, with a panel for each scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from benchmarks.skips_table import Measured
from stereogs.experiments.showing.against_time import Sample, front

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw(measured: Sequence[Measured], path: Path) -> None:
    """Draw a numbered point for each switch, the mean over its seeds, and the Pareto front as a line."""
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(m.scene for m in measured))
    figure = Figure(figsize=(9, 3.6 * len(scenes)), dpi=100, layout="constrained")
    panels = figure.subplots(len(scenes), 1, squeeze=False)[:, 0]
    for axes, scene in zip(panels, scenes, strict=True):
        _panel(axes, scene, [m for m in measured if m.scene == scene])
    figure.savefig(path)


def _panel(axes: Axes, scene: str, measured: Sequence[Measured]) -> None:
    samples = {}
    for switch in dict.fromkeys(m.switch for m in measured):
        runs = [m for m in measured if m.switch == switch]
        samples[switch] = Sample(fmean(m.cpu_seconds for m in runs), fmean(m.psnr for m in runs))
    best = sorted(front(samples.values(), higher_is_better=True), key=lambda s: s.seconds)
    axes.plot([s.seconds for s in best], [s.value for s in best], color="0.7", zorder=1)
    for number, (switch, sample) in enumerate(samples.items(), 1):
        color = "C0" if sample in best else "C1"
        axes.scatter(sample.seconds, sample.value, s=28, color=color, label=f"{number}  {switch}")
        up_or_down = (4, 5) if number % 2 else (4, -12)
        place = (sample.seconds, sample.value)
        axes.annotate(str(number), place, up_or_down, textcoords="offset points", fontsize=9)
    axes.margins(0.08, 0.12)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, frameon=False)
    axes.set_title(f"{scene}: weightfree_fast, one switch at a time", fontsize=10)
    axes.set_xlabel("CPU seconds of the whole run, all threads together")
    axes.set_ylabel("PSNR of test views, dB")
    axes.grid(alpha=0.25)
