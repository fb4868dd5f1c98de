"""What each switch saves and costs, as a table in Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean, stdev
from typing import NamedTuple


class Measured(NamedTuple):
    """One run.

    Args:
        switch: which one was thrown.
        scene, seed: what it was trained on and with.
        cpu_seconds: of its whole process, all threads.
        psnr: dB.
        ssim: in [-1, 1].
        gaussians: at the end.
    """

    switch: str
    scene: str
    seed: int
    cpu_seconds: float
    psnr: float
    ssim: float
    gaussians: int


def table(measured: Sequence[Measured], default: str) -> str:
    """A row for each switch and scene: its numbers, and its difference from the default's, seed by seed.

    Args:
        default: the name of the row that others are compared with.
    """
    lines = [
        "| switch | scene | CPU s | saved | PSNR | gained, dB | SSIM | Gaussians | seeds |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    by_run = {(m.switch, m.scene, m.seed): m for m in measured}
    for switch in dict.fromkeys(m.switch for m in measured):
        for scene in dict.fromkeys(m.scene for m in measured):
            runs = [m for m in measured if m.switch == switch and m.scene == scene]
            pairs = [
                (run, by_run[default, scene, run.seed])
                for run in runs
                if (default, scene, run.seed) in by_run
            ]
            if runs and pairs:
                lines.append(_row(switch, scene, pairs, is_default=switch == default))
    return "\n".join(lines)


def _row(
    switch: str, scene: str, pairs: Sequence[tuple[Measured, Measured]], *, is_default: bool
) -> str:
    runs = [run for run, _ in pairs]
    saved = [1 - run.cpu_seconds / base.cpu_seconds for run, base in pairs]
    gained = [run.psnr - base.psnr for run, base in pairs]
    cells = [
        switch,
        scene,
        f"{fmean(run.cpu_seconds for run in runs):.1f}",
        "" if is_default else f"{fmean(saved):+.0%}",
        f"{fmean(run.psnr for run in runs):.2f}{_spread([run.psnr for run in runs])}",
        "" if is_default else f"{fmean(gained):+.2f}{_spread(gained)}",
        f"{fmean(run.ssim for run in runs):.3f}",
        f"{fmean(run.gaussians for run in runs):,.0f}",
        str(len(runs)),
    ]
    return f"| {' | '.join(cells)} |"


def _spread(values: Sequence[float]) -> str:
    """The standard deviation over seeds; nothing with one."""
    spread = stdev(values) if len(values) > 1 else math.nan
    return "" if math.isnan(spread) else f" ± {spread:.2f}"
