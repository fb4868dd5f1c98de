"""How good the test views were after how many seconds: the curves behind one number a run.

Seconds are those until the Gaussians were there: loading, first points and training. Scores on the way and
at the end, and files, are not in them: they come after the picture.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from registry.runs import METRICS

from ..planning.plan import Combination, PlannedRun
from ..running.folder import AblationFolder
from .scores import Figure, Results, figure_of


@dataclass(frozen=True)
class Sample:
    """Scores at a moment, averaged over seeds.

    Args:
        seconds: since the run began.
        value: of the metric.
        spread: sample standard deviation of the value over the seeds; None with one seed.
    """

    seconds: float
    value: float
    spread: float | None = None


Samples = Sequence[tuple[int, float, Mapping[str, float | None]]]
"""Iteration, seconds, and the test views' mean of each metric, in order."""
Curves = Mapping[PlannedRun, Samples]
"""Of each finished run."""


def read_curves(results: Results, folder: AblationFolder) -> Curves:
    """The scores on the way that each finished run has kept, and those of its end."""
    return {run: _curve(found, folder, run) for run, found in results.items() if found}


def _curve(found: Mapping[str, Any], folder: AblationFolder, run: PlannedRun) -> Samples:
    stages = found.get("stages", {})
    before = stages.get("scene", 0.0) + stages.get("initialization", 0.0)
    file = folder.run(run).path / METRICS
    lines = [json.loads(line) for line in _lines(file.read_text("utf-8") if file.is_file() else "")]
    end = int(found.get("iterations", 0))
    curve = [
        (int(line["iteration"]), before + float(line["seconds"]), line["test"])
        for line in lines
        if {"iteration", "seconds", "test"} <= {*line} and line["iteration"] < end
    ]
    missing = found.get("unavailable", {})
    last = {name: score for name, score in found.get("test", {}).items() if name not in missing}
    return [*curve, (end, before + float(found.get("seconds", 0.0)), last)]


def _lines(text: str) -> Iterable[str]:
    """Whole lines; the last one may have been cut off by a power failure."""
    return (line for line in text.splitlines() if line.startswith("{") and line.endswith("}"))


def curve(curves: Curves, combination: Combination, scene: str, metric: str) -> list[Sample]:
    """A combination's samples on a scene, over those iterations that all seeds have scored."""
    by_iteration: dict[int, list[tuple[float, float]]] = {}
    own = [run for run in curves if run.combination == combination and run.scene == scene]
    for run in own:
        for iteration, seconds, scores in curves[run]:
            value = scores.get(metric)
            if value is not None and math.isfinite(value):
                by_iteration.setdefault(iteration, []).append((seconds, value))
    return [_sample(found) for _, found in sorted(by_iteration.items()) if len(found) == len(own)]


def _sample(found: Sequence[tuple[float, float]]) -> Sample:
    values = [value for _, value in found]
    return Sample(
        statistics.fmean(seconds for seconds, _ in found),
        statistics.fmean(values),
        statistics.stdev(values) if len(values) > 1 else None,
    )


def reached(curves: Curves, combination: Combination, metric: str, seconds: float) -> Figure | None:
    """What a combination had reached by then, over scenes and seeds; None if a run had no score yet."""
    by_seed: dict[int, list[float]] = {}
    for run, samples in curves.items():
        if run.combination == combination:
            value = _last_by(samples, metric, seconds)
            if value is None:
                return None
            by_seed.setdefault(run.seed, []).append(value)
    return figure_of(by_seed)


def _last_by(samples: Samples, metric: str, seconds: float) -> float | None:
    known = [scores.get(metric) for _, after, scores in samples if after <= seconds]
    finite = [value for value in known if value is not None and math.isfinite(value)]
    return finite[-1] if finite else None


def front(samples: Iterable[Sample], *, higher_is_better: bool) -> set[Sample]:
    """Those that no other one beats: none is as good in less time, and none better in as much (Pareto)."""
    sign = 1 if higher_is_better else -1
    best, kept = -math.inf, set()
    for sample in sorted(samples, key=lambda s: (s.seconds, -sign * s.value)):
        if sign * sample.value > best:
            best = sign * sample.value
            kept.add(sample)
    return kept
