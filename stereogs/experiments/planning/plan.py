"""The runs to train: every combination on every scene with every seed."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

from registry.discovery import Plugins
from registry.errors import PipelineError
from registry.messages.suggestions import counted
from registry.pipeline.edits import set_value
from registry.pipeline.pipeline import Pipeline, checked_pipeline
from registry.pipeline.yaml_source import Node, Place

from .variations import Alternative, Change, Variation

SEED = "training.seed"
_NAME_LENGTH = 100


@dataclass(frozen=True)
class Combination:
    """One row of the table.

    Args:
        on: the state of each toggle.
        choices: the value of each variation; None if the varied component is off.
    """

    on: tuple[bool, ...]
    choices: tuple[Alternative | None, ...]


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """One training.

    Args:
        combination, scene, seed: its place in the plan.
        pipeline: complete and checked.
        digest: hash of the complete pipeline; identifies the run's folder.
        name: of a new folder: a description, then the digest.
    """

    combination: Combination
    scene: str
    seed: int
    pipeline: Pipeline
    digest: str
    name: str


@dataclass(frozen=True)
class Plan:
    """All runs of an ablation or bench.

    Args:
        name: for titles and the output folder.
        toggles: names of the parts that are switched on and off.
        variations: the varied settings.
        scenes, seeds: each combination is trained on all of them.
        combinations: the rows of the table.
        runs: sorted by combination, then scene, then seed.
        kind: "ablation" or "bench", for titles and file names.
    """

    name: str
    toggles: tuple[str, ...]
    variations: tuple[Variation, ...]
    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    combinations: tuple[Combination, ...]
    runs: tuple[PlannedRun, ...] = ()
    kind: str = "ablation"

    @property
    def size(self) -> str:
        """The number of runs as a product, for messages."""
        factors = {
            "combination": len(self.combinations),
            "scene": len(self.scenes),
            "seed": len(self.seeds),
        }
        terms = (counted(count, name) for name, count in factors.items())
        return f"{' x '.join(terms)} = {counted(len(self.runs), 'run')}"

    def describe(self, combination: Combination) -> str:
        """Return for example "stereo_depth off, opacity.base 0.99"."""
        toggles = zip(self.toggles, combination.on, strict=True)
        parts = [f"{name} {'on' if on else 'off'}" for name, on in toggles]
        for variation, choice in zip(self.variations, combination.choices, strict=True):
            parts += [f"{variation.name} {choice.label}"] if choice else []
        return ", ".join(parts)


def with_runs(
    plan: Plan,
    scenes: Sequence[Alternative],
    pipeline_of: Callable[[Combination, Alternative, int], Pipeline],
) -> Plan:
    """Add a run for each combination, scene and seed to a plan without runs.

    Args:
        scenes: the plan's scenes.
        pipeline_of: returns the pipeline for a combination, scene and seed.

    Raises:
        PipelineError: two combinations give the same pipeline.
    """
    runs: dict[str, PlannedRun] = {}
    for combination, scene, seed in itertools.product(plan.combinations, scenes, plan.seeds):
        pipeline = pipeline_of(combination, scene, seed)
        digest = pipeline_digest(pipeline)
        if digest in runs:
            first = runs[digest]
            raise PipelineError(
                "two combinations are the same pipeline: "
                f"({plan.describe(first.combination)}, scene {first.scene}) and "
                f"({plan.describe(combination)}, scene {scene.label})",
                where=plan.name,
                fix="remove the toggle, value or scene that changes nothing",
            )
        name = _folder_name(plan, combination, scene.label, seed, digest)
        runs[digest] = PlannedRun(combination, scene.label, seed, pipeline, digest, name)
    return replace(plan, runs=tuple(runs.values()))


def pipeline_digest(pipeline: Pipeline) -> str:
    """Return the first ten hexadecimal digits of the SHA-256 hash of the complete pipeline."""
    return hashlib.sha256(pipeline.to_yaml().encode()).hexdigest()[:10]


def changed_pipeline(
    root: Node, changes: Sequence[Change], seed: int, plugins: Plugins
) -> Pipeline:
    """Build the pipeline of a tree with changes, applied in order to a copy, and a seed."""
    tree = deepcopy(root)
    seeded = Change(SEED, Node(seed, Place(f"training seed {seed}")))
    for change in (*changes, seeded):
        set_value(tree, change.path, deepcopy(change.value), change.value.place)
    return checked_pipeline(tree, plugins)


def _folder_name(plan: Plan, combination: Combination, scene: str, seed: int, digest: str) -> str:
    """Return scene, seed, enabled toggles and values, shortened, followed by the digest."""
    parts = [scene, f"seed-{seed}"]
    parts += [name for name, on in zip(plan.toggles, combination.on, strict=True) if on]
    parts += ["all-off"] if plan.toggles and not any(combination.on) else []
    for variation, choice in zip(plan.variations, combination.choices, strict=True):
        parts += [f"{variation.name.split('.')[-1]}-{choice.label}"] if choice else []
    words = [re.sub(r"[^A-Za-z0-9.-]+", "-", part).strip("-.") for part in parts]
    return f"{'_'.join(words)[:_NAME_LENGTH].rstrip('_-.')}_{digest}"
