"""Trainings of `make results`: four pipelines on every data set, each by its protocol."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from benchmarks.trainings import DATA, PIPELINES, VGG, Case, Method, Training, written_digest
from registry.discovery import Plugins
from registry.pipeline.edits import apply_override
from registry.pipeline.pipeline import checked_pipeline
from registry.pipeline.yaml_source import read

LPIPS_SEED = 0
"""The seed whose runs have LPIPS, which takes longer than a short training."""


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
    return Case(data, views, "", (scene, f"metrics=[psnr, ssim, {VGG}]"))


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


def planned_runs(
    cases: Sequence[Case], methods: Sequence[Method], seeds: Sequence[int], plugins: Plugins
) -> list[Training]:
    """Return the checked trainings of every method on every case, sorted by seed.

    Raises:
        PipelineError: a pipeline cannot be read or contradicts the protocol.
    """
    return [
        _planned(case, method, seed, plugins)
        for seed, method, case in product(seeds, methods, cases)
    ]


def _planned(case: Case, method: Method, seed: int, plugins: Plugins) -> Training:
    tree = read(method.file)
    extra = case.baseline_overrides if method.baseline else ()
    for override in (*case.overrides, *extra, f"training.seed={seed}"):
        apply_override(tree, override)
    pipeline = checked_pipeline(tree, plugins)
    name = f"{case.data}-{case.views}_{method.file.stem}_{seed}"
    identity = {
        "data": case.data,
        "train_views": case.views,
        "method": method.file.stem,
        "seed": seed,
    }
    without = () if seed == LPIPS_SEED else (VGG,)
    digest = written_digest(tree)
    return Training(name, identity, case, method, seed, pipeline, digest, without)
