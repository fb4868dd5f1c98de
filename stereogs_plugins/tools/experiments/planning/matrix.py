"""What to bench: pipelines x lengths x scenes x seeds, as a matrix file says it.

pipelines: [weightfree_fast, ./mine.yaml]     names of ready ones, or paths beside the matrix
scenes: [llff_fern, {use: procedural}]
iterations: [100, 400]                        without it: as each pipeline says
seeds: 3
runner: {use: ray}                            without it: processes of this machine
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

from registry.errors import PipelineError
from registry.messages import did_you_mean, listing
from registry.pipeline import Node, Pipeline, find_pipeline, plain, read
from registry.plugins import Plugins

from .description import seed_count, written_scenes
from .making import changed, with_runs
from .plan import Combination, Plan
from .scenes import AblatedScene, find_scenes
from .variations import Choice, Variation, values

KEYS = ("pipelines", "scenes", "iterations", "seeds", "runner")
"""The keys of a matrix file."""
PIPELINE = "pipeline"
LENGTH = "training.iterations"


@dataclass(frozen=True)
class Matrix:
    """A matrix before anything is looked up.

    Args:
        name: for titles and the output folder.
        pipelines: their trees, by name.
        scenes: texts or mappings, see scenes.py; one or more.
        lengths: of the runs; None: as each pipeline says.
        seeds: how many, >= 1, from 0 on.
        runner: who trains them, as a pipeline writes a component; None: processes of this machine.
    """

    name: str
    pipelines: dict[str, Node]
    scenes: tuple[Node, ...]
    lengths: Variation | None
    seeds: int
    runner: Node | None


def read_matrix(path: Path) -> Matrix:
    """Read a matrix file and the pipelines that it names.

    Raises:
        PipelineError: a file that cannot be read, unknown keys, wrong types, nothing in a list.
    """
    root = read(path)
    if not isinstance(root.content, dict):
        raise PipelineError(
            f"a matrix is a mapping, not {root.kind}",
            where=str(root.place),
            fix=f"keys: {listing(KEYS)}",
        )
    keys = root.content
    for key, node in keys.items():
        if key not in KEYS:
            raise PipelineError(
                f"a matrix has no key {key!r}{did_you_mean(key, KEYS)}",
                where=str(node.place),
                fix=f"keys: {listing(KEYS)}",
            )
    scenes = written_scenes(keys.get("scenes"))
    if not scenes:
        raise PipelineError(
            "the matrix does not say which scenes to train on",
            where=str(root.place),
            fix="write for example `scenes: [llff_fern, llff_flower]`",
        )
    return Matrix(
        path.stem,
        _pipelines(keys.get("pipelines"), path, root),
        scenes,
        values(LENGTH, keys["iterations"]) if "iterations" in keys else None,
        seed_count(keys.get("seeds")),
        keys.get("runner"),
    )


def plan_of(matrix: Matrix, plugins: Plugins) -> Plan:
    """Every pipeline, length, scene and seed, each checked before anything runs.

    Raises:
        PipelineError: an unknown name, a value that is refused, two that are the same pipeline.
        PluginError: a component cannot be loaded.
    """
    pipelines = Variation(PIPELINE, tuple(Choice(name, ()) for name in matrix.pipelines))
    variations = (pipelines, *([matrix.lengths] if matrix.lengths else []))
    first = next(iter(matrix.pipelines.values()))
    scenes = find_scenes(first, matrix.scenes)
    combinations = itertools.product(*(variation.choices for variation in variations))

    def pipeline(combination: Combination, scene: AblatedScene, seed: int) -> Pipeline:
        (name, *lengths) = (choice for choice in combination.choices if choice is not None)
        changes = [change for length in lengths for change in length.changes]
        moved = [scene.change] if scene.change else []
        return changed(matrix.pipelines[name.label], [*moved, *changes], seed, plugins)

    plan = Plan(
        matrix.name,
        (),
        variations,
        tuple(scene.label for scene in scenes),
        tuple(range(matrix.seeds)),
        tuple(Combination((), choices) for choices in combinations),
        (),
        "bench",
    )
    return with_runs(plan, scenes, pipeline)


def _pipelines(node: Node | None, path: Path, root: Node) -> dict[str, Node]:
    written = plain(node) if node else None
    if not isinstance(written, list) or not all(isinstance(name, str) for name in written):
        raise PipelineError(
            "the matrix does not say which pipelines to train",
            where=str(node.place if node else root.place),
            fix="write for example `pipelines: [3dgs_fast, ./mine.yaml]`",
        )
    found: dict[str, Node] = {}
    for name in written:
        label = Path(name).stem
        if label in found:
            raise PipelineError(
                f"two pipelines are called {label!r}",
                where=str(node.place if node else root.place),
                fix="remove one, or give its file another name",
            )
        beside = path.parent / name
        found[label] = read(beside if beside.is_file() else find_pipeline(Path(name)))
    if not found:
        raise PipelineError(
            "the list of pipelines is empty",
            where=str(node.place if node else root.place),
            fix="name one or more",
        )
    return found
