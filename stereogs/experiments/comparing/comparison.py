"""Finished runs and the means of each method."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from registry import RunError
from registry.pipeline.settings_check import plain
from registry.pipeline.yaml_source import read
from registry.runs.folder import RESULTS, RunFolder
from registry.runs.results import read_results

from ..showing.scores import Figure, figure_of

COSTS = {"gaussians": "Gaussians", "seconds": "seconds", "peak_memory_mb": "memory MB"}
"""Costs in results.json, with their headings."""
_NEEDED = ("pipeline", "protocol", "scene", "metrics", "test", "gaussians")
_NOT_TRAINED = ("metrics", "exporters", "reports", "observers")


@dataclass(frozen=True)
class FinishedRun:
    """A finished run.

    Args:
        folder: the run folder.
        results: the content of results.json.
        tree: its pipeline as plain values, and `packages` of plugins that trained it.
        method: the pipeline without the scene's path, the seed, and sections that do not affect training.
        inputs: digests of photographs and cameras by their name, see `input_digests`; empty for an old run.
    """

    folder: Path
    results: Mapping[str, Any]
    tree: Mapping[str, Any]
    method: str
    inputs: Mapping[str, str] = field(default_factory=dict)

    @property
    def pipeline(self) -> str:
        """Name of the pipeline."""
        return str(self.results["pipeline"])

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return str(self.results["scene"]["name"])

    @property
    def protocol(self) -> str | None:
        """Name of the protocol with its modifications, for example "blender-8"; None without one."""
        record = self.results["protocol"]
        if record is None:
            return None
        changes = (f"{setting}={value}" for setting, value in record["modified"].items())
        return ", ".join([str(record["name"]), *changes])

    @property
    def scores(self) -> dict[str, float | None]:
        """Mean of each metric over the test views; None for an unavailable metric."""
        return dict(self.results["test"])

    @property
    def seed(self) -> int:
        """Seed of its training."""
        return int(self.tree["training"]["seed"])

    @property
    def numbers(self) -> dict[str, float | None]:
        """Scores and costs."""
        return {**self.scores, **{key: self.results.get(key) for key in COSTS}}


@dataclass(frozen=True)
class MethodMean:
    """The means of a method over scenes; several runs of a scene count once.

    Args:
        method: name of its pipeline, with a run folder if two methods share the name.
        scenes: the averaged scenes.
        numbers: scores and costs; None if a run lacks one.
    """

    method: str
    scenes: tuple[str, ...]
    numbers: dict[str, float | None]


def read_run(path: Path) -> FinishedRun:
    """Read a finished run.

    Raises:
        RunError: not a run folder, an unfinished run, or results.json is invalid or of an older version.
    """
    run = RunFolder.existing(path)
    path = run.path
    if not (path / RESULTS).exists():
        raise RunError(
            "the run has not finished: it has no results.json",
            where=str(path),
            fix=f"stereogs resume {path}",
        )
    results = read_results(path / RESULTS)
    missing = [key for key in _NEEDED if key not in results]
    if "facts" not in results.get("scene", {}):
        missing.append("the scene's facts")
    if missing:
        raise RunError(
            f"results.json of an older version lacks {', '.join(missing)}",
            where=str(path),
            fix=f"stereogs eval {path}",
        )
    tree = plain(read(run.pipeline))
    tree["packages"] = {  # those of metrics separate tables, see `check_comparable`
        name: package
        for name, package in results.get("packages", {}).items()
        if name.partition(".")[0] not in _NOT_TRAINED
    }
    if removed := sum(edit["removed"] for edit in results.get("edits", ())):
        # Each edit counts as a method, named by its hash: no pipeline produces these Gaussians.
        tree["edited"] = f"{removed:,} removed by hand ({results['hash'][:8]})"
    return FinishedRun(path, results, tree, _method(tree), run.inputs()[0] or {})


def _method(pipeline: Mapping[str, Any]) -> str:
    tree = copy.deepcopy(dict(pipeline))
    for section in _NOT_TRAINED:
        tree.pop(section, None)
    tree["scene"].pop("path", None)
    tree["training"].pop("seed", None)
    return json.dumps(tree, sort_keys=True)


def method_means(runs: Sequence[FinishedRun]) -> list[MethodMean]:
    """Return the means of each method over its scenes, in the order of the runs.

    Means of different `MethodMean.scenes` are not comparable.
    """
    groups: dict[str, list[FinishedRun]] = {}
    for run in runs:
        groups.setdefault(run.method, []).append(run)
    names = [group[0].pipeline for group in groups.values()]
    means = []
    for group, name in zip(groups.values(), names, strict=True):
        label = name if names.count(name) == 1 else f"{name} ({group[0].folder.name})"
        scenes = sorted({run.scene for run in group})
        by_scene = [_means([run.numbers for run in group if run.scene == s]) for s in scenes]
        means.append(MethodMean(label, tuple(scenes), _means(by_scene)))
    return means


def seed_means(runs: Sequence[FinishedRun]) -> list[tuple[FinishedRun, int, dict[str, Figure]]]:
    """Return the means of runs that differ only in the seed; runs of one seed count once.

    Returns:
        The first run of each group with several seeds, the number of seeds, and the means of the numbers
        that all runs have.
    """
    groups: dict[tuple[str, str], list[FinishedRun]] = {}
    for run in runs:
        groups.setdefault((run.method, run.scene), []).append(run)
    found = []
    for group in groups.values():
        seeds = {run.seed for run in group}
        if len(seeds) < 2:
            continue
        means = {}
        for name in dict.fromkeys(name for run in group for name in run.numbers):
            by_seed: dict[int, list[float]] = {seed: [] for seed in sorted(seeds)}
            for run in group:
                number = run.numbers.get(name)
                by_seed[run.seed] += [] if number is None else [number]
            if sum(map(len, by_seed.values())) == len(group) and (mean := figure_of(by_seed)):
                means[name] = mean
        found.append((group[0], len(seeds), means))
    return found


def _means(rows: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Return the mean of each number; None if a row lacks it."""
    means: dict[str, float | None] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        known = [value for value in values if value is not None]
        means[name] = sum(known) / len(known) if len(known) == len(values) else None
    return means


def metric_names(runs: Iterable[FinishedRun]) -> list[str]:
    """Return the metrics of all runs, in order."""
    return list(dict.fromkeys(name for run in runs for name in run.scores))


def dotted(tree: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings with dotted names."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{start}{key}.")
        else:
            yield f"{start}{key}", value
