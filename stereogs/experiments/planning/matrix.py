"""Read a matrix file: pipelines x lengths x scenes x seeds.

pipelines: [weightfree_fast, ./mine.yaml]     names of ready pipelines, or paths relative to this file
scenes: [llff_fern, {use: procedural}]
iterations: [100, 400]                        default: the length of each pipeline
seeds: 3
runner: {use: ray}                            default: processes on this machine
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

from registry.discovery import Plugins
from registry.errors import PipelineError
from registry.messages.suggestions import listing
from registry.pipeline.pipeline import Pipeline
from registry.pipeline.ready import find_pipeline
from registry.pipeline.settings_check import plain
from registry.pipeline.yaml_source import Node, read

from .description import check_keys, scene_list, seed_count
from .plan import Combination, Plan, changed_pipeline, with_runs
from .variations import Alternative, Variation, scene_choices, values

KEYS = ("pipelines", "scenes", "iterations", "seeds", "runner")
"""The keys of a matrix file."""


@dataclass(frozen=True)
class Matrix:
    """A matrix before it is checked against its pipelines.

    Args:
        name: for titles and the output folder.
        pipelines: their trees, by name.
        scenes: at least one; see `scene_choices`.
        lengths: variation of the number of iterations; None for the length of each pipeline.
        seeds: number of seeds, >= 1, counted from 0.
        runner: a component that trains the runs; None for processes on this machine.
    """

    name: str
    pipelines: dict[str, Node]
    scenes: tuple[Node, ...]
    lengths: Variation | None
    seeds: int
    runner: Node | None


def read_matrix(path: Path) -> Matrix:
    """Read a matrix file and its pipelines.

    Raises:
        PipelineError: a file cannot be read, or has unknown keys, wrong types or empty lists.
    """
    root = read(path)
    if not isinstance(root.content, dict):
        raise PipelineError(
            f"a matrix must be a mapping, not {root.kind}",
            where=str(root.place),
            fix=f"keys: {listing(KEYS)}",
        )
    keys = root.content
    check_keys(keys, KEYS, "a matrix")
    scenes = scene_list(keys.get("scenes"))
    if not scenes:
        raise PipelineError(
            "the matrix lists no scenes",
            where=str(root.place),
            fix="write for example `scenes: [llff_fern, llff_flower]`",
        )
    return Matrix(
        path.stem,
        _pipelines(keys.get("pipelines") or Node(None, root.place), path),
        scenes,
        values("training.iterations", keys["iterations"]) if "iterations" in keys else None,
        seed_count(keys.get("seeds")),
        keys.get("runner"),
    )


def plan_of(matrix: Matrix, plugins: Plugins) -> Plan:
    """Plan every pipeline, length, scene and seed, and check each before anything runs.

    Raises:
        PipelineError: an unknown name, a rejected value, or two equal pipelines.
        PluginError: a component cannot be loaded.
    """
    pipelines = Variation("pipeline", tuple(Alternative(name, ()) for name in matrix.pipelines))
    variations = (pipelines, *([matrix.lengths] if matrix.lengths else []))
    scenes = scene_choices(next(iter(matrix.pipelines.values())), matrix.scenes)
    combinations = itertools.product(*(variation.choices for variation in variations))

    def pipeline(combination: Combination, scene: Alternative, seed: int) -> Pipeline:
        (name, *lengths) = (choice for choice in combination.choices if choice is not None)
        changes = [change for choice in (scene, *lengths) for change in choice.changes]
        return changed_pipeline(matrix.pipelines[name.label], changes, seed, plugins)

    plan = Plan(
        matrix.name,
        (),
        variations,
        tuple(scene.label for scene in scenes),
        tuple(range(matrix.seeds)),
        tuple(Combination((), choices) for choices in combinations),
        kind="bench",
    )
    return with_runs(plan, scenes, pipeline)


def _pipelines(node: Node, path: Path) -> dict[str, Node]:
    written = plain(node)
    if not isinstance(written, list) or not all(isinstance(name, str) for name in written):
        raise PipelineError(
            "the matrix lists no pipelines",
            where=str(node.place),
            fix="write for example `pipelines: [3dgs_fast, ./mine.yaml]`",
        )
    found: dict[str, Node] = {}
    for name in written:
        label = Path(name).stem
        if label in found:
            raise PipelineError(
                f"two pipelines are called {label!r}",
                where=str(node.place),
                fix="remove one, or give its file another name",
            )
        file = path.parent / name
        found[label] = read(file if file.is_file() else find_pipeline(Path(name)))
    if not found:
        raise PipelineError(
            "the list of pipelines is empty", where=str(node.place), fix="name one or more"
        )
    return found
