"""What `benchmarks.results` trains: four pipelines on every data set, each by its protocol."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.planned_training import written_digest
from registry import RunError
from registry.messages import listing
from registry.pipeline import Pipeline, apply_override, read
from registry.pipeline import checked_pipeline as build_pipeline
from registry.plugins import Plugins

DATA = "STEREOGS_DATA"
PIPELINES = Path(__file__).parent.parent / "pipelines"
SEEDS = (0, 1, 2)
LPIPS = "lpips"
LPIPS_SEED = 0
"""The seed whose runs have LPIPS: it takes longer than a short training."""


@dataclass(frozen=True)
class Case:
    """A data set with a number of training views.

    Args:
        data: the data set's name, which is its folder's too.
        views: how many photographs train.
        protocol: its name, as in papers' tables; empty: the scene is in none of them.
        overrides: what `--set` would say to both pipelines: the protocol and the scene.
        baseline_overrides: the same for the baseline alone.
    """

    data: str
    views: int
    protocol: str
    overrides: tuple[str, ...]
    baseline_overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Method:
    """A pipeline that is measured.

    Args:
        title: the table's word for it.
        file: the pipeline.
        baseline: whether it takes `Case.baseline_overrides`, and the others are compared with it.
    """

    title: str
    file: Path
    baseline: bool = False


@dataclass(frozen=True, eq=False)
class Measurement:
    """One training: a method on a case.

    Args:
        digest: of the pipeline as it is written, the same wherever the data lie.
    """

    case: Case
    method: Method
    seed: int
    pipeline: Pipeline
    digest: str

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.case.data}-{self.case.views}_{self.method.file.stem}_{self.seed}"

    @property
    def without(self) -> tuple[str, ...]:
        """Metrics of its protocol that are not measured."""
        return () if self.seed == LPIPS_SEED else (LPIPS,)

    @property
    def identity(self) -> dict[str, Any]:
        """What a record says of it."""
        return {
            "data": self.case.data,
            "train_views": self.case.views,
            "method": self.method.file.stem,
            "seed": self.seed,
        }


METHODS = (
    Method("plain", PIPELINES / "3dgs_fast.yaml", baseline=True),
    Method("fast", PIPELINES / "weightfree_fast.yaml"),
    Method("long", PIPELINES / "weightfree.yaml"),
    Method("networks", PIPELINES / "with_networks.yaml"),
)


def _standard(protocol: str, loader: str, data: str, views: int) -> Case:
    name = f"{protocol}-{views}"
    scene = f"scene={{use: {loader}, path: '${{{DATA}}}/{data}'}}"
    return Case(data, views, name, (f"protocol={name}", scene))


def _bonsai(views: int) -> Case:
    """This sample has no images_8, and the bounds of Mip-NeRF 360's files are placeholders.

    Triangulating grows with the pairs of photographs, minutes here: the baseline starts at random.
    """
    data, protocol = "mip360_bonsai", f"mipnerf360-{views}"
    return Case(
        data,
        views,
        protocol,
        (
            f"protocol={{use: {protocol}, modified: [scene.images]}}",
            f"scene={{use: llff, path: '${{{DATA}}}/{data}', images: images_800, bounds: estimate}}",
        ),
        ("initializer=random",),
    )


def temple(views: int) -> Case:
    """Middlebury's temple on a turntable before black."""
    return _without_protocol("nerfstudio", "mview_temple", views)


def _without_protocol(loader: str, data: str, views: int) -> Case:
    """Every eighth photograph tests."""
    scene = f"scene={{use: {loader}, path: '${{{DATA}}}/{data}', train_views: {views}}}"
    return Case(data, views, "", (scene, f"metrics=[psnr, ssim, {LPIPS}]"))


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
    temple(views=9),
    temple(views=20),
    _without_protocol("colmap", "colmap_lightfield9", 7),
)


def cases(*names: str) -> tuple[Case, ...]:
    """Some of `CASES`, such as "llff_fern-3"."""
    return tuple(case for case in CASES if f"{case.data}-{case.views}" in names)


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
    cases: Sequence[Case], methods: Sequence[Method], seeds: Sequence[int], plugins: Plugins
) -> list[Measurement]:
    """Every method on every case, the first seed of everything before the second; all are checked.

    Raises:
        PipelineError: a pipeline cannot be read or contradicts the protocol.
    """
    return [
        _planned(case, method, seed, plugins)
        for seed, method, case in product(seeds, methods, cases)
    ]


def _planned(case: Case, method: Method, seed: int, plugins: Plugins) -> Measurement:
    tree = read(method.file)
    extra = case.baseline_overrides if method.baseline else ()
    for override in (*case.overrides, *extra, f"training.seed={seed}"):
        apply_override(tree, override)
    pipeline = build_pipeline(tree, plugins)
    return Measurement(case, method, seed, pipeline, written_digest(tree))
