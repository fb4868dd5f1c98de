"""Tables of `benchmarks.next_views`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from benchmarks import pages
from stereogs.experiments.showing.score_table import markdown

TARGET = "bench-next"
PAGE = pages.DOCS / "next_photograph.md"
SUGGESTED, RANDOM = "suggested", "random"
STEPS = (1, 2, 3)
NEW = ("llff_fortress", "llff_room", "dtu_scan65", "dtu_scan114")
"""Scenes on which nothing of the suggestion was chosen."""
_RESAMPLES, _SEED = 10_000, 0


@dataclass(frozen=True)
class Measured:
    """The scores of a scene.

    Args:
        curves: PSNR of the test views after the start and each further photograph, by rule, dB.
        fourth: PSNR after each choice of the 4th photograph, dB.
    """

    scene: str
    curves: dict[str, list[float]]
    fourth: list[float]

    def after(self, rule: str, step: int) -> float | None:
        """Return the PSNR of a rule after a step from 1 to 3; of "random", the mean over the draws.

        None without a record. The mean random choice of the 4th photograph is that of all choices.
        """
        if rule == RANDOM and step == 1:
            return fmean(self.fourth)
        own = [curve for name, curve in self.curves.items() if name.split()[0] == rule.split()[0]]
        known = [curve[step] for curve in own if len(curve) > step]
        return fmean(known) if known else None

    def ahead(self, rule: str, step: int) -> float | None:
        """Return how far the suggestion is ahead of a rule after a step, dB; None without a record."""
        one, other = self.after(SUGGESTED, step), self.after(rule, step)
        return None if one is None or other is None else one - other

    @property
    def gap(self) -> float:
        """Share of the way from the mean choice of the 4th photograph to the best one."""
        mean = fmean(self.fourth)
        return (self.curves[SUGGESTED][1] - mean) / (max(self.fourth) - mean)


RULES = (SUGGESTED, "longest gap", "farthest", RANDOM)


def table(measured: Sequence[Measured]) -> str:
    """Return the PSNR of each rule after the 4th, 5th and 6th photograph, a row per scene."""
    rows = []
    for one in measured:
        scores = [[one.after(rule, step) for step in STEPS] for rule in RULES]
        cells = [" / ".join("-" if x is None else f"{x:.2f}" for x in row) for row in scores]
        start, best = f"{one.curves[SUGGESTED][0]:.2f}", f"{max(one.fourth):.2f}"
        rows.append([one.scene, start, *cells, best, f"{100 * one.gap:.0f} %"])
    headings = ["scene", "3 photographs", *RULES, "best 4th", "share of the way"]
    return markdown(headings, rows)


def summary(measured: Sequence[Measured]) -> str:
    """Return how much the suggestion is ahead of the other rules, mean over the scenes with intervals."""
    rows = []
    for rule in RULES[1:]:
        steps = [[m.ahead(rule, step) for m in measured] for step in STEPS]
        rows.append([f"ahead of {rule}, dB", *(_cell(values) for values in steps)])
    for title, scenes in (
        ("", measured),
        (" (new scenes)", [m for m in measured if m.scene in NEW]),
    ):
        if scenes:
            gap = interval([100 * m.gap for m in scenes], digits=0)
            rows.append([f"from the mean choice to the best{title}, %", gap, "", ""])
    return markdown(["", "4th", "5th", "6th"], rows)


def _cell(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    few = f", {len(known)} scenes" if len(known) < len(values) else ""
    return interval(known) + few if known else ""


def interval(values: Sequence[float], digits: int = 2) -> str:
    """Return a mean and its 95 % interval (bootstrap over the scenes, percentiles)."""
    generator = np.random.default_rng(_SEED)
    drawn = generator.choice(np.array(values), (_RESAMPLES, len(values))).mean(axis=1)
    low, high = np.percentile(drawn, (2.5, 97.5))
    return f"{fmean(values):+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"


def write_page(measured: Sequence[Measured]) -> None:
    """Write the summary into the page, and the table of the scenes."""
    pages.rewrite(PAGE, pages.marks(TARGET), summary(measured))
    pages.write_tables("next_views", "The next photograph", TARGET, table(measured))
