"""The records of `benchmarks.skips_plan` as tables and a picture: time and PSNR of each switch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from benchmarks.cells import Records, spread
from benchmarks.records import Record
from benchmarks.skips_plan import CASES, DEFAULT
from stereogs.experiments.showing.against_time import Sample, front
from stereogs.experiments.showing.score_table import markdown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = "shortcuts.png"
HEADINGS = ("switch", "scene", "CPU s", "saved", "PSNR", "gained, dB", "SSIM", "Gaussians", "seeds")
Row = tuple[str, ...]
"""Cells below `HEADINGS`: means over seeds; *saved* and *gained* are relative to the default."""


def tables(records: Records, _: int) -> str:
    """Return a row for each switch and scene."""
    return markdown(HEADINGS, _rows(records).values(), names=2)


def _rows(records: Records) -> dict[tuple[str, str], Row]:
    """The rows by switch and scene; runs are compared with the default seed by seed."""
    groups = _grouped(records)
    found = {}
    for (switch, scene), runs in groups.items():
        bases = groups.get((DEFAULT, scene), {})
        pairs = [(run, bases[seed]) for seed, run in runs.items() if seed in bases]
        if pairs:
            found[switch, scene] = (switch, scene, *_cells(pairs, is_default=switch == DEFAULT))
    return found


def _grouped(records: Records) -> dict[tuple[str, str], dict[int, Record[Any]]]:
    """The records by switch and scene, then by seed."""
    names = {case: name for name, case in CASES.items()}
    switches = dict.fromkeys(record.run.method.title for record in records)
    return {
        (switch, names[case]): own
        for switch in switches
        for case in names
        if (
            own := {
                record.run.seed: record
                for record in records
                if record.run.method.title == switch and record.run.case is case
            }
        )
    }


def _cells(pairs: Sequence[tuple[Record[Any], Record[Any]]], *, is_default: bool) -> Iterator[str]:
    runs = [run for run, _ in pairs]
    saved = [1 - _seconds(run) / _seconds(base) for run, base in pairs]
    gained = [run.scores["psnr"] - base.scores["psnr"] for run, base in pairs]
    yield f"{fmean(map(_seconds, runs)):.1f}"
    yield "" if is_default else f"{fmean(saved):+.0%}"
    yield spread([run.scores["psnr"] for run in runs])
    yield "" if is_default else spread(gained, "+.2f").replace("± +", "± ")
    yield f"{fmean(run.scores['ssim'] for run in runs):.3f}"
    yield f"{fmean(run.measured['gaussians'] for run in runs):,.0f}"
    yield str(len(runs))


def _seconds(record: Record[Any]) -> float:
    """CPU seconds of the whole process."""
    return float(record.measured["process_cpu_seconds"])


def draw(records: Records, folder: Path) -> None:
    """Draw a numbered point for each switch, the mean over its seeds, and the Pareto front as a line."""
    from matplotlib.figure import Figure

    groups = _grouped(records)
    scenes = list(dict.fromkeys(scene for _, scene in groups))
    figure = Figure(figsize=(9, 3.6 * len(scenes)), dpi=100, layout="constrained")
    panels = figure.subplots(len(scenes), 1, squeeze=False)[:, 0]
    for axes, scene in zip(panels, scenes, strict=True):
        samples = {
            switch: Sample(
                fmean(map(_seconds, runs.values())),
                fmean(run.scores["psnr"] for run in runs.values()),
            )
            for (switch, where), runs in groups.items()
            if where == scene
        }
        _panel(axes, scene, samples)
    figure.savefig(folder / PICTURE)


def _panel(axes: Axes, scene: str, samples: Mapping[str, Sample]) -> None:
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
