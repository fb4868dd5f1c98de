"""Scores of trainings as tables show them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable
from typing import Any

from benchmarks.spread import NONE
from benchmarks.training_records import Record

VGG, ALEXNET = "lpips", "lpips_alex"
HEADINGS = {"ssim": "SSIM", VGG: "LPIPS", ALEXNET: "LPIPS, Alex", "avge": "AVGE"}
"""Of columns, by the score's name; PSNR has columns of its own."""


def scores_shown(records: Iterable[Record[Any]]) -> dict[str, str]:
    """`HEADINGS`, without AlexNet's where no record has it: older ones do not."""
    by_alexnet = any(ALEXNET in record.scores for record in records)
    return {name: text for name, text in HEADINGS.items() if name != ALEXNET or by_alexnet}


def score_of(name: str) -> Callable[[Record[Any]], float | None]:
    """What reads a score from a record; None where the record has none."""
    return lambda record: record.scores.get(name)


def mean_over_scenes(
    by_scene: Iterable[Iterable[Record[Any]]],
    number: Callable[[Record[Any]], float | None],
    form: str,
) -> str:
    """The mean over scenes of the mean over each one's records, of those that have the number."""
    known = [[n for n in map(number, records) if n is not None] for records in by_scene]
    means = [statistics.mean(numbers) for numbers in known if numbers]
    return format(statistics.mean(means), form) if means else NONE
