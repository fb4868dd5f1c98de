"""Trainings of `make results`: four pipelines on every data set, each by its protocol."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.planned_training import written_digest
from registry import RunError
from registry.discovery import Plugins
from registry.messages.suggestions import listing
from registry.pipeline.edits import apply_override
from registry.pipeline.pipeline import Pipeline, build_pipeline
from registry.pipeline.yaml_source import read

DATA = "STEREOGS_DATA"
PIPELINES = Path(__file__).parent.parent / "pipelines"
SEEDS = (0, 1, 2)
LPIPS = "lpips"
LPIPS_SEED = 0
"""The seed whose runs have LPIPS, which takes longer than a short training."""


@dataclass(frozen=True)
class Case:
    """A data set with a number of training views.

    Args:
        data: Name of the data set and of its folder.
        views: Number of training photographs.
        protocol: Name of the protocol; empty if published protocols do not cover the scene.
        overrides: Overrides of all pipelines, as for `--set`: protocol and scene.
        baseline_overrides: Overrides of the baseline only.
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
        title: Name in tables.
        file: File of the pipeline.
        baseline: If True, it takes `Case.baseline_overrides` and the others are compared with it.
    """

    title: str
    file: Path
    baseline: bool = False


@dataclass(frozen=True, eq=False)
class Measurement:
    """One training: a method on a case.

    Args:
        digest: Digest of the pipeline, independent of the location of the data.
    """

    case: Case
    method: Method
    seed: int
    pipeline: Pipeline
    digest: str

    @property
    def name(self) -> str:
        """Name of its record and of its folder of outputs."""
        return f"{self.case.data}-{self.case.views}_{self.method.file.stem}_{self.seed}"

    @property
    def without(self) -> tuple[str, ...]:
        """Metrics of its protocol to leave out."""
        return () if self.seed == LPIPS_SEED else (LPIPS,)

    @property
    def identity(self) -> dict[str, Any]:
        """Its description in a record."""
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
    """Return a case of bonsai, whose sample lacks images_8 and has placeholders as bounds.

    Triangulation of all pairs of photographs would take minutes: the baseline starts at random.
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
    """Return a case of Middlebury's temple on a turntable, on black."""
    return _without_protocol("nerfstudio", "mview_temple", views)


def _without_protocol(loader: str, data: str, views: int) -> Case:
    """A case without a protocol; every eighth photograph tests."""
    scene = f"scene={{use: {loader}, path: '${{{DATA}}}/{data}', train_views: {views}}}"
    return Case(data, views, "", (scene, f"metrics=[psnr, ssim, {LPIPS}]"))


CASES = (
    *(
        _standard("llff", "llff", data, n)
        for data in ("llff_fern", "llff_flower", "llff_fortress", "llff_room")
        for n in (3, 6, 9)
    ),
    *(
        _standard("dtu", "dtu", data, n)
        for data in ("dtu_scan24", "dtu_scan65", "dtu_scan114")
        for n in (3, 6, 9)
    ),
    _standard("blender", "blender", "blender_lego", 8),
    _bonsai(12),
    _bonsai(24),
    temple(views=9),
    temple(views=20),
    _without_protocol("colmap", "colmap_lightfield9", 7),
)


def cases(*names: str) -> tuple[Case, ...]:
    """Return some of `CASES` by names such as "llff_fern-3"."""
    return tuple(case for case in CASES if f"{case.data}-{case.views}" in names)


def check_data(wanted: Iterable[str]) -> None:
    """Check that the data sets are present.

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
    """Return the checked trainings of every method on every case, sorted by seed.

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
