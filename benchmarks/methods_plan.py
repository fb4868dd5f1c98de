"""Trainings of `make methods`: every method from its own points and from the same ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.results_plan import cases
from benchmarks.trainings import (
    PIPELINES,
    POINTS,
    SEEDS,
    Case,
    Method,
    Points,
    Training,
    written_digest,
)
from registry.discovery import Plugins
from registry.pipeline.edits import apply_override, set_value
from registry.pipeline.pipeline import checked_pipeline
from registry.pipeline.yaml_source import Node, Place, read

SAME_POINTS = Path(__file__).with_name("same_points.yaml")
"""The initializer of the *same* points."""
AUTHORS_SETTINGS = Path(__file__).with_name("authors_settings.yaml")
"""Settings of the authors for data sets other than LLFF."""


@dataclass(frozen=True)
class Group:
    """Cases that share a table.

    Args:
        title: Suffix of the table's title.
        cases: Columns of the table.
        points: First points, with a table for each.
        seeds: Seeds of the trainings.
    """

    title: str
    cases: tuple[Case, ...]
    points: tuple[Points, ...]
    seeds: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class MethodTraining(Training):
    """A training of a method from some first points."""

    points: Points = "own"


def _short(title: str, name: str, paper: str | None = None) -> Method:
    return Method(title, PIPELINES / "methods" / f"{name}-short.yaml", paper=paper)


BASELINE = _short("3DGS", "3dgs", "3dgs")
STEREOGS = Method("StereoGS", PIPELINES / "stereogs_short.yaml", paper="stereogs")
NETWORKED = (
    STEREOGS,
    Method("StereoGS, dropout", PIPELINES / "stereogs_dropout_short.yaml", paper="stereogs_drop"),
)
"""Methods whose networks dominate the time."""
METHODS = (
    BASELINE,
    _short("DropGaussian", "dropgaussian", "dropgaussian"),
    Method("weightfree.yaml", PIPELINES / "weightfree.yaml", points=("same",)),
    _short("Binocular3DGS", "binocular3dgs", "binocular3dgs"),
    _short("Co-Adaptation", "co-adaptation"),
    _short("D²GS", "d2gs", "d2gs"),
    _short("MCMC", "mcmc"),
    _short("AbsGS", "absgs"),
    _short("RegNeRF", "regnerf", "regnerf"),
    _short("FreeNeRF", "freenerf", "freenerf"),
    _short("SparseNeRF", "sparsenerf", "sparsenerf"),
    _short("ICO-GS", "ico-gs"),
    _short("MVPGS", "mvpgs", "mvpgs"),
    _short("FSGS", "fsgs", "fsgs"),
    _short("NexusGS", "nexusgs", "nexusgs"),
    _short("DNGaussian", "dngaussian", "dngaussian"),
    _short("CoR-GS", "cor-gs", "cor_gs"),
    *NETWORKED,
)
"""Methods in the order of training: the baseline first, the slowest last."""


GROUPS = (
    Group("", cases("llff_fern-3", "llff_flower-3"), POINTS, SEEDS),
    Group(
        "around objects", cases("dtu_scan24-3", "dtu_scan65-3", "blender_lego-8"), ("same",), (0,)
    ),
)


def planned_runs(
    methods: Sequence[Method], groups: Sequence[Group], plugins: Plugins
) -> list[MethodTraining]:
    """Return all runs, sorted by seed; within a group `NETWORKED` come last.

    Raises:
        PipelineError: a pipeline cannot be read or contradicts the protocol.
    """
    return [
        planned_run(method, points, case, seed, plugins)
        for seed in sorted({seed for group in groups for seed in group.seeds})
        for group in groups
        if seed in group.seeds
        for stereo in (False, True)
        for case in group.cases
        for method in methods
        if stereo == (method in NETWORKED)
        for points in group.points
        if points in method.points
    ]


def planned_run(
    method: Method, points: Points, case: Case, seed: int, plugins: Plugins
) -> MethodTraining:
    """Return the checked training of a method on a case.

    Raises:
        PipelineError: see `planned_runs`.
    """
    tree = read(method.file)
    as_authors_set_it(tree, method, case)
    if points == "same":
        _start_from_the_same(tree)
    metrics = "metrics=[psnr, ssim, lpips]"
    for override in (*case.overrides, metrics, f"training.seed={seed}"):
        apply_override(tree, override)
    pipeline = checked_pipeline(tree, plugins)
    file = method.file.stem
    name = f"{file}_{points}_{case.data}_{seed}"
    identity = {"method": file, "points": points, "data": case.data, "seed": seed}
    digest = written_digest(tree)
    return MethodTraining(name, identity, case, method, seed, pipeline, digest, points=points)


def as_authors_set_it(tree: Node, method: Method, case: Case) -> None:
    """Apply the `AUTHORS_SETTINGS` of the method for the case's data set."""
    of_method = _parts(read(AUTHORS_SETTINGS), case.protocol.partition("-")[0]).get(
        method.file.stem
    )
    if of_method is not None and isinstance(of_method.content, dict):
        for path, value in of_method.content.items():
            set_value(tree, path, value, value.place)


def _start_from_the_same(tree: Node) -> None:
    """Use the initializer of `SAME_POINTS`, with the pipeline's plane sweep or an added one."""
    place = Place(SAME_POINTS.name)
    initializer, own = _parts(read(SAME_POINTS), "initializer"), _parts(tree, "initializer")
    if "hand_on_depth" in own:  # a loss of the method needs it, the points do not change
        initializer["hand_on_depth"] = own["hand_on_depth"]
    initializer["prior"] = Node(_plane_sweep(tree, place), place)
    set_value(tree, "initializer", Node(initializer, place), place)


def _plane_sweep(tree: Node, place: Place) -> str:
    """The name of the pipeline's plane sweep, which is added if missing."""
    priors = list(_items(tree, "priors"))
    for prior in priors:
        written = prior.as_written()
        names = written if isinstance(written, dict) else {"use": written}
        if names["use"] == "plane_sweep":
            return str(names.get("name", "plane_sweep"))
    priors.append(Node("plane_sweep", place))
    set_value(tree, "priors", Node(priors, place), place)
    return "plane_sweep"


def _parts(tree: Node, section: str) -> dict[str, Node]:
    """The entries of a section by name; empty if it is missing or a plain text."""
    node = tree.content.get(section) if isinstance(tree.content, dict) else None
    return node.content if node is not None and isinstance(node.content, dict) else {}


def _items(tree: Node, section: str) -> Iterator[Node]:
    node = tree.content.get(section) if isinstance(tree.content, dict) else None
    if node is not None:
        yield from node.content if isinstance(node.content, list) else [node]
