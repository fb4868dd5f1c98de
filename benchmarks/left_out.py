"""Scores on training views left out, for choices that no test view may make: `make bench-left-out`.

For each training view of a scene the pipeline trains on all others and renders that one. A scene of
three photographs is another one without a third of them: take 6 or 9 views to choose what three will use.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.results_plan import CASES, PIPELINES, Case, check_data
from core_rasterizer.errors import ExplainedError
from registry import RunError, Scene
from registry.messages.suggestions import listing
from registry.pipeline.pipeline import Pipeline
from registry.session import build_pipeline, load_scene, train

FEWEST_VIEWS = 3
"""Two must be left, or no depth can be confirmed."""
DEFAULT_CASES = ("llff_flower-6", "dtu_scan65-6", "blender_lego-8")


def folds(scene: Scene) -> Iterator[Scene]:
    """The scene once for each training view, which is its only test view then, and trains no more.

    Sparse points are left out: they have seen the view.

    Raises:
        RunError: fewer than three training views.
    """
    if len(scene.train) < FEWEST_VIEWS:
        raise RunError(
            f"{len(scene.train)} training views are too few to leave one out",
            where=scene.name,
            fix=f"take {FEWEST_VIEWS} or more",
        )
    for view in scene.train:
        others = tuple(other for other in scene.train if other is not view)
        yield replace(scene, train=others, test=(view,), points=None)


def measure(pipeline: Pipeline, scene: Scene) -> Iterator[tuple[str, dict[str, float | None]]]:
    """For each fold the name of the view left out, and its score by each metric of the pipeline."""
    free = replace(pipeline, protocol=None)  # which fixes the views, and they are given here
    for fold in folds(scene):
        run = train(free, scene=fold, progress=False)
        yield fold.test[0].name, run.evaluate()["test"].mean


def name_of(case: Case) -> str:
    """A case's name on the command line."""
    return f"{case.data}-{case.views}"


def _print(case: Case, source: Path, changes: list[str], console: Console) -> None:
    pipeline = build_pipeline(source, [*case.overrides, *changes])
    metrics = ("psnr", "ssim")
    table = Table("left out", *metrics, title=f"{name_of(case)}, {pipeline.name}")
    totals = dict.fromkeys(metrics, 0.0)
    scene = load_scene(pipeline)
    for view, scores in measure(pipeline, scene):
        values = [scores[metric] for metric in metrics]
        table.add_row(view, *("-" if value is None else f"{value:.4g}" for value in values))
        for metric, value in zip(metrics, values, strict=True):
            totals[metric] += (value or 0.0) / len(scene.train)
    table.add_section()
    table.add_row("mean", *(f"{totals[metric]:.4g}" for metric in metrics))
    console.print(table)


def main() -> int:
    names = {name_of(case): case for case in CASES}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=DEFAULT_CASES, help=listing(list(names)))
    parser.add_argument("--pipeline", type=Path, default=PIPELINES / "weightfree_fast.yaml")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change the pipeline"
    )
    arguments = parser.parse_args()
    unknown = [name for name in arguments.cases if name not in names]
    if unknown:
        parser.error(f"there is no {listing(unknown)}; choose from {listing(list(names))}")
    cases = [names[name] for name in arguments.cases]
    try:
        check_data(cases)
        for case in cases:
            _print(case, arguments.pipeline, arguments.set, Console(markup=False))
    except ExplainedError as error:
        sys.exit(f"left_out: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
