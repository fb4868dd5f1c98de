"""Cells that the tables of trainings share."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from benchmarks.records import Record
from benchmarks.trainings import ALEXNET, VGG
from stereogs.experiments.showing.scores import difference

Records = Sequence[Record[Any]]

NONE = "\u2013"
"""A cell without a number."""
HEADINGS = {"ssim": "SSIM", VGG: "LPIPS", ALEXNET: "LPIPS, Alex", "avge": "AVGE"}
"""Headings of columns by the score's name; PSNR has columns of its own."""


def spread(values: Sequence[float], form: str = ".2f") -> str:
    """Return the mean, with the sample standard deviation of several values."""
    if not values:
        return NONE
    mean = format(statistics.mean(values), form)
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):{form}}"


def scores_shown(records: Records) -> dict[str, str]:
    """Return `HEADINGS`, without AlexNet's if no record has that score: older ones lack it."""
    by_alexnet = any(ALEXNET in record.scores for record in records)
    return {name: text for name, text in HEADINGS.items() if name != ALEXNET or by_alexnet}


def score_of(name: str) -> Callable[[Record[Any]], float | None]:
    """Return a function that reads a score from a record; None where the record lacks it."""
    return lambda record: record.scores.get(name)


def mean_over_scenes(
    by_scene: Iterable[Iterable[Record[Any]]],
    number: Callable[[Record[Any]], float | None],
    form: str,
) -> str:
    """Return the mean over scenes of each scene's mean over its records that have the number."""
    known = [[n for n in map(number, records) if n is not None] for records in by_scene]
    means = [statistics.mean(numbers) for numbers in known if numbers]
    return format(statistics.mean(means), form) if means else NONE


def gain(records: Records, baseline: Records) -> str:
    """Return the mean difference in PSNR over pairs of the same scene and seed, with its interval."""
    found = difference(_psnr(records), _psnr(baseline))
    return NONE if found is None else found.text()


def _psnr(records: Records) -> dict[tuple[str, int, int], float]:
    return {
        (record.run.case.data, record.run.case.views, record.run.seed): record.scores["psnr"]
        for record in records
    }


def count(records: Records, planned: int) -> str:
    """Return the number of runs and their devices, as a sentence."""
    devices = dict.fromkeys(record.processor for record in records)
    return f"{len(records)} of {planned} runs, on {' and '.join(devices) or 'no device yet'}."


def commonest_processor(records: Records) -> str:
    """Return the processor of most trainings; on a tie, the first."""
    ((name, _),) = Counter(record.processor for record in records).most_common(1)
    return name


def cpu_seconds(record: Record[Any]) -> float:
    """Return the CPU seconds of a training."""
    return float(record.measured["cpu_seconds"])


def time_ratio(own: Records, baseline: Records) -> str:
    """Return the ratio of CPU seconds to a baseline's.

    Geometric mean over scenes and processors common to both, of means over seeds; seconds of different
    processors are not comparable.
    """
    others = _seconds(baseline)
    ratios = [
        statistics.mean(seconds) / statistics.mean(others[place])
        for place, seconds in _seconds(own).items()
        if place in others
    ]
    return format(statistics.geometric_mean(ratios), ".1f") if ratios else NONE


def _seconds(records: Records) -> dict[tuple[str, str], list[float]]:
    found: dict[tuple[str, str], list[float]] = {}
    for record in records:
        place = (record.run.case.data, record.processor)
        found.setdefault(place, []).append(cpu_seconds(record))
    return found
