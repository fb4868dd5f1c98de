"""What each switch saves and costs, as a picture: PSNR against CPU seconds, a panel for each scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from benchmarks.skips_table import Measured
from registry.ablation.showing.samples import Sample, front

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw(measured: Sequence[Measured], path: Path) -> None:
    """A point for each switch, the mean over its seeds; the Pareto front is a line."""
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(m.scene for m in measured))
    figure = Figure(figsize=(8.5, 4.6 * len(scenes)), dpi=100, layout="constrained")
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
    for switch, sample in samples.items():
        axes.scatter(sample.seconds, sample.value, s=28, color="C0" if sample in best else "C1")
        axes.annotate(
            switch, (sample.seconds, sample.value), (5, 4), textcoords="offset points", fontsize=8
        )
    axes.margins(0.16, 0.12)
    axes.set_title(f"{scene}: weightfree_fast, one switch at a time", fontsize=10)
    axes.set_xlabel("CPU seconds of the whole run, all threads together")
    axes.set_ylabel("PSNR of test views, dB")
    axes.grid(alpha=0.25)
