"""What `benchmarks.results` trains: two pipelines on every data set, each by its protocol."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from registry import RunError
from registry.ablation.planning.making import pipeline_digest
from registry.ablation.planning.plan import Combination, PlannedRun
from registry.messages.suggestions import listing
from registry.pipeline.edits import apply_override
from registry.pipeline.pipeline import build_pipeline
from registry.pipeline.yaml_source import read
from registry.plugins.discovery import Plugins

DATA = "STEREOGS_DATA"
PIPELINES = Path(__file__).parent.parent / "pipelines"


@dataclass(frozen=True)
class Case:
    """A data set with a number of training views.

    Args:
        data: the data set's name, which is its folder's too.
        views: how many photographs train.
        overrides: what `--set` would say to both pipelines: the protocol and the scene.
        baseline_overrides: the same for the baseline alone.
    """

    data: str
    views: int
    overrides: tuple[str, ...]
    baseline_overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Method:
    """A pipeline that is measured.

    Args:
        title: the table's word for it.
        file: the pipeline.
        baseline: whether it takes `Case.baseline_overrides`.
    """

    title: str
    file: Path
    baseline: bool = False


@dataclass(frozen=True, eq=False)
class Measurement:
    """One cell group of the table: a method on a case."""

    case: Case
    method: Method
    run: PlannedRun


METHODS = (
    Method("plain", PIPELINES / "3dgs_fast.yaml", baseline=True),
    Method("weight-free", PIPELINES / "weightfree_fast.yaml"),
)


def _standard(protocol: str, loader: str, data: str, views: int) -> Case:
    scene = f"scene={{use: {loader}, path: '${{{DATA}}}/{data}'}}"
    return Case(data, views, (f"protocol={protocol}-{views}", scene))


def _bonsai(views: int) -> Case:
    """This sample has no images_8, and the bounds of Mip-NeRF 360's files are placeholders.

    Triangulating grows with the pairs of photographs, minutes here: the baseline starts at random.
    """
    data = "mip360_bonsai"
    return Case(
        data,
        views,
        (
            f"protocol={{use: mipnerf360-{views}, modified: [scene.images]}}",
            f"scene={{use: llff, path: '${{{DATA}}}/{data}', images: images_800, bounds: estimate}}",
        ),
        ("initializer=random",),
    )


CASES = (
    *(
        _standard("llff", "llff", data, n)
        for data in ("llff_fern", "llff_flower")
        for n in (3, 6, 9)
    ),
    *(_standard("dtu", "dtu", data, n) for data in ("dtu_scan24", "dtu_scan65") for n in (3, 6, 9)),
    _standard("blender", "blender", "blender_lego", 8),
    _bonsai(12),
    _bonsai(24),
)


def check_data(wanted: Iterable[str]) -> None:
    """Refuse to begin without the data sets.

    Raises:
        RunError: STEREOGS_DATA is not set, or has no folder of that name for some.
    """
    names = list(dict.fromkeys(wanted))
    root = os.environ.get(DATA)
    if not root:
        raise RunError(
            f"{DATA} is not set", fix=f"set it to the folder that holds {listing(names)}"
        )
    missing = [name for name in names if not Path(root, name).is_dir()]
    if missing:
        raise RunError(
            f"{DATA} lacks {listing(missing)}", where=root, fix="put each into a folder of its name"
        )


def make_measurements(
    cases: Sequence[Case],
    methods: Sequence[Method],
    plugins: Plugins,
    iterations: int | None = None,
) -> list[Measurement]:
    """Every method on every case, checked before anything is trained.

    Args:
        iterations: in place of what the pipelines say.

    Raises:
        PipelineError: a pipeline cannot be read or contradicts the protocol.
    """
    return [
        Measurement(case, method, _planned(case, method, plugins, iterations))
        for case in cases
        for method in methods
    ]


def _planned(case: Case, method: Method, plugins: Plugins, iterations: int | None) -> PlannedRun:
    tree = read(method.file)
    overrides = [*case.overrides, *(case.baseline_overrides if method.baseline else ())]
    if iterations is not None:
        overrides.append(f"training.iterations={iterations}")
    for override in overrides:
        apply_override(tree, override)
    pipeline = build_pipeline(tree, plugins)
    digest = pipeline_digest(pipeline)
    name = f"{case.data}-{case.views}_{pipeline.name}_{digest}"
    seed = pipeline.training.seed
    return PlannedRun(Combination((), ()), case.data, seed, pipeline, digest, name)
