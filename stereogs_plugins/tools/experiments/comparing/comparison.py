"""Finished runs side by side, and the averages of each method."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from registry import RunError
from registry.pipeline import plain, read
from registry.runs import RESULTS, RunFolder, read_results

COSTS = ("gaussians", "seconds", "peak_memory_mb")
"""What results.json says a run cost."""
_NEEDED = ("pipeline", "protocol", "scene", "metrics", "test", "gaussians")


@dataclass(frozen=True)
class FinishedRun:
    """What a comparison needs of one run.

    Args:
        folder: of the run.
        results: its results.json.
        tree: its pipeline, as plain values.
        method: the pipeline without what may differ between scenes and repetitions: the scene's path, the
            seed, and what does not touch training.
    """

    folder: Path
    results: Mapping[str, Any]
    tree: Mapping[str, Any]
    method: str

    @property
    def pipeline(self) -> str:
        """The pipeline's name."""
        return str(self.results["pipeline"])

    @property
    def scene(self) -> str:
        """The scene's name."""
        return str(self.results["scene"]["name"])

    @property
    def protocol(self) -> str | None:
        """The protocol's name with its modifications, if it follows one: "blender-8"."""
        record = self.results["protocol"]
        if record is None:
            return None
        changes = (f"{setting}={value}" for setting, value in record["modified"].items())
        return ", ".join([str(record["name"]), *changes])

    @property
    def scores(self) -> dict[str, float | None]:
        """Means over the test views by metric; None where a metric was not available."""
        return dict(self.results["test"])


@dataclass(frozen=True)
class MethodMean:
    """One method's averages over scenes; a scene with several runs counts once.

    Args:
        method: its pipeline's name; with a run's folder where two methods share the name.
        scenes: that the average goes over.
        numbers: by metric, and "gaussians", "seconds", "peak_memory_mb"; None where a run lacks it.
    """

    method: str
    scenes: tuple[str, ...]
    numbers: dict[str, float | None]


def read_run(path: Path) -> FinishedRun:
    """A run that has ended.

    Raises:
        RunError: this is no run folder, the run has not ended, its results cannot be believed (see
            `read_results`), or it was scored by an older version.
    """
    run = RunFolder.existing(path)
    if not (path / RESULTS).exists():
        raise RunError(
            "the run has no results.json: it has not ended",
            where=str(path),
            fix=f"stereogs resume {path}",
        )
    results = read_results(path / RESULTS)
    missing = [key for key in _NEEDED if key not in results]
    if "facts" not in results.get("scene", {}):
        missing.append("the scene's facts")
    if missing:
        raise RunError(
            f"results.json does not say {', '.join(missing)}: an older version wrote it",
            where=str(path),
            fix=f"stereogs eval {path}",
        )
    tree = plain(read(run.pipeline))
    return FinishedRun(path, results, tree, _method(tree))


def method_means(runs: Sequence[FinishedRun]) -> list[MethodMean]:
    """Averages of each method over its scenes, in the order of the runs.

    Only methods that were run on the same scenes can be averaged side by side; the caller looks at
    `MethodMean.scenes`.
    """
    groups: dict[str, list[FinishedRun]] = {}
    for run in runs:
        groups.setdefault(run.method, []).append(run)
    names = [group[0].pipeline for group in groups.values()]
    means = []
    for group, name in zip(groups.values(), names, strict=True):
        label = name if names.count(name) == 1 else f"{name} ({group[0].folder.name})"
        scenes = sorted({run.scene for run in group})
        by_scene = [_mean_numbers([_numbers(r) for r in group if r.scene == s]) for s in scenes]
        means.append(MethodMean(label, tuple(scenes), _mean_numbers(by_scene)))
    return means


def metric_names(runs: Iterable[FinishedRun]) -> list[str]:
    """The metrics of any of the runs, in their order."""
    return list(dict.fromkeys(name for run in runs for name in run.scores))


def _numbers(run: FinishedRun) -> dict[str, float | None]:
    costs = {key: run.results.get(key) for key in COSTS}
    return {**run.scores, **costs}


def _mean_numbers(rows: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Means of the numbers that every row has."""
    means: dict[str, float | None] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        known = [value for value in values if value is not None]
        means[name] = sum(known) / len(known) if len(known) == len(values) else None
    return means


def _method(pipeline: Mapping[str, Any]) -> str:
    tree = copy.deepcopy(dict(pipeline))
    for section in ("metrics", "exporters", "reports", "observers"):
        tree.pop(section, None)
    tree["scene"].pop("path", None)
    tree["training"].pop("seed", None)
    return json.dumps(tree, sort_keys=True)
