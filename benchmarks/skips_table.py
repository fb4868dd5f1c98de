"""Time and PSNR of each switch as tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

from benchmarks import pages
from benchmarks.cells import spread


class Measured(NamedTuple):
    """One run.

    Args:
        switch: Label of the switch.
        scene: Name of the scene.
        seed: Seed of the training.
        cpu_seconds: CPU seconds of the whole process, all threads.
        psnr: PSNR of the test views, dB.
        ssim: SSIM of the test views, in [-1, 1].
        gaussians: Number of Gaussians at the end.
    """

    switch: str
    scene: str
    seed: int
    cpu_seconds: float
    psnr: float
    ssim: float
    gaussians: int


class Row(NamedTuple):
    """Cells of a switch in a scene: means over seeds; *saved* and *gained* are relative to the default."""

    switch: str
    scene: str
    cpu_seconds: str
    saved: str
    psnr: str
    gained: str
    ssim: str
    gaussians: str
    seeds: str


def rows(measured: Sequence[Measured], default: str) -> list[Row]:
    """Return a row for each switch and scene.

    Args:
        default: Label of the runs that the others are compared with, seed by seed.
    """
    by_run = {(m.switch, m.scene, m.seed): m for m in measured}
    found = []
    for switch in dict.fromkeys(m.switch for m in measured):
        for scene in dict.fromkeys(m.scene for m in measured):
            runs = [m for m in measured if m.switch == switch and m.scene == scene]
            pairs = [
                (run, by_run[default, scene, run.seed])
                for run in runs
                if (default, scene, run.seed) in by_run
            ]
            if pairs:
                found.append(_row(switch, scene, pairs, is_default=switch == default))
    return found


def table(rows: Sequence[Row]) -> str:
    """Return all cells as a table."""
    headings = [
        "switch",
        "scene",
        "CPU s",
        "saved",
        "PSNR",
        "gained, dB",
        "SSIM",
        "Gaussians",
        "seeds",
    ]
    return pages.table(headings, rows, left=2)


def summary(rows: Sequence[Row], default: str) -> str:
    """Return time saved and PSNR gained as a table with a row for each switch."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    by_place = {(row.switch, row.scene): row for row in rows}
    lines = []
    for switch in dict.fromkeys(row.switch for row in rows if row.switch != default):
        shown = [by_place[switch, scene] for scene in scenes]
        lines.append([switch, *(row.saved for row in shown), *(row.gained for row in shown)])
    headings = [f"{name}, {scene}" for name in ("saved", "gained") for scene in scenes]
    return pages.table(["switch", *headings], lines)


def _row(
    switch: str, scene: str, pairs: Sequence[tuple[Measured, Measured]], *, is_default: bool
) -> Row:
    runs = [run for run, _ in pairs]
    saved = [1 - run.cpu_seconds / base.cpu_seconds for run, base in pairs]
    gained = [run.psnr - base.psnr for run, base in pairs]
    return Row(
        switch,
        scene,
        f"{fmean(run.cpu_seconds for run in runs):.1f}",
        "" if is_default else f"{fmean(saved):+.0%}",
        spread([run.psnr for run in runs]),
        "" if is_default else spread(gained, "+.2f").replace("± +", "± "),
        f"{fmean(run.ssim for run in runs):.3f}",
        f"{fmean(run.gaussians for run in runs):,.0f}",
        str(len(runs)),
    )
