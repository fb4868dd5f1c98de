"""Tables of `benchmarks.next_views`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from benchmarks import pages

PAGE = pages.DOCS / "next_photograph.md"
SUGGESTED = "suggested"
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

    def mean_of(self, rule: str) -> list[float]:
        """Return the curve of a rule; of "random", the mean over the draws."""
        own = [curve for name, curve in self.curves.items() if name.split()[0] == rule.split()[0]]
        return [fmean(values) for values in zip(*own, strict=True)]

    @property
    def gap(self) -> float:
        """Share of the way from the mean choice of the 4th photograph to the best one."""
        mean = fmean(self.fourth)
        return (self.curves[SUGGESTED][1] - mean) / (max(self.fourth) - mean)


RULES = (SUGGESTED, "longest gap", "farthest", "random")


def table(measured: Sequence[Measured]) -> str:
    """Return the PSNR of each rule after the 4th, 5th and 6th photograph, a row per scene."""
    rows = []
    for one in measured:
        curves = [one.mean_of(rule) for rule in RULES]
        cells = [" / ".join(f"{value:.2f}" for value in curve[1:]) for curve in curves]
        start, best = f"{curves[0][0]:.2f}", f"{max(one.fourth):.2f}"
        rows.append([one.scene, start, *cells, best, f"{100 * one.gap:.0f} %"])
    headings = ["scene", "3 photographs", *RULES, "best 4th", "share of the way"]
    return pages.table(headings, rows)


def summary(measured: Sequence[Measured]) -> str:
    """Return how much the suggestion is ahead of the other rules, mean over the scenes with intervals."""
    rows = []
    for rule in RULES[1:]:
        cells = [
            interval([m.curves[SUGGESTED][step] - m.mean_of(rule)[step] for m in measured])
            for step in (1, 2, 3)
        ]
        every = interval(
            [
                fmean(m.curves[SUGGESTED][step] - m.mean_of(rule)[step] for step in (1, 2, 3))
                for m in measured
            ]
        )
        rows.append([f"ahead of {rule}, dB", *cells, every])
    gap = interval([100 * m.gap for m in measured], digits=0)
    rows.append(["share of the way from the mean choice to the best, %", gap, "", "", ""])
    return pages.table(["", "4th", "5th", "6th", "all three"], rows)


def interval(values: Sequence[float], digits: int = 2) -> str:
    """Return a mean and its 95 % interval (bootstrap over the scenes, percentiles)."""
    generator = np.random.default_rng(_SEED)
    drawn = generator.choice(np.array(values), (_RESAMPLES, len(values))).mean(axis=1)
    low, high = np.percentile(drawn, (2.5, 97.5))
    return f"{fmean(values):+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"


def write_page(measured: Sequence[Measured]) -> None:
    """Write both tables into the page."""
    text = f"{summary(measured)}\n{table(measured)}"
    pages.rewrite(PAGE, pages.marks("bench-next"), text)
