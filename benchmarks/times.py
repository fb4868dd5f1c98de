"""Processor times of trainings on several machines: in seconds on one of them, as ratios on each."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence
from typing import Any

from benchmarks.spread import NONE
from benchmarks.training_records import Record, processor


def commonest_processor(records: Sequence[Record[Any]]) -> str:
    """Where most of some trainings ran; of several such, where the first of them did."""
    ((name, _),) = Counter(map(processor, records)).most_common(1)
    return name


def cpu_seconds(record: Record[Any]) -> float:
    """What a training took."""
    return float(record.measured["cpu_seconds"])


def time_ratio(own: Sequence[Record[Any]], baseline: Sequence[Record[Any]]) -> str:
    """How many times the CPU seconds of a baseline some trainings took, as a cell of a table.

    The geometric mean over scenes and processors that both were trained on, over seeds in each; seconds
    of one processor say nothing about another's.
    """
    others = _seconds(baseline)
    ratios = [
        statistics.mean(seconds) / statistics.mean(others[place])
        for place, seconds in _seconds(own).items()
        if place in others
    ]
    return format(statistics.geometric_mean(ratios), ".1f") if ratios else NONE


def _seconds(records: Sequence[Record[Any]]) -> dict[tuple[str, str], list[float]]:
    found: dict[tuple[str, str], list[float]] = {}
    for record in records:
        place = (record.run.case.data, processor(record))
        found.setdefault(place, []).append(cpu_seconds(record))
    return found
