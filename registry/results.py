"""The end of a run: scores, pictures, exports, reports, results.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from core_rasterizer import GaussianModel

from .blame import blame
from .evaluation import evaluate
from .memory import peak_memory_mb
from .metrics_log import jsonable
from .parts import Parts
from .pipeline import Pipeline
from .provenance import describe_device
from .run import RunFolder
from .scene import Scene

RENDERS = "renders"
EXPORTS = "exports"


def finish(
    run: RunFolder,
    pipeline: Pipeline,
    parts: Parts,
    scene: Scene,
    model: GaussianModel,
    seconds: float,
) -> None:
    """Evaluate, export, write results.json, and let the reports do their work.

    Args:
        seconds: spent training.
    """
    scores = score(run, parts, scene, model)
    exported: list[str] = []
    for part in parts["exporters"]:
        with blame(part.item):
            written = part.component.export(model, scene, run.folder(EXPORTS))
        exported += [_inside(run, file) for file in written]
    iterations = pipeline.training.iterations
    run.write_results(
        jsonable(
            {
                **describe(pipeline, scene, model, iterations),
                "initialization": run.initialization(),
                "seconds": round(seconds, 3),
                "iterations_per_second": round(iterations / max(seconds, 1e-9), 3),
                "peak_memory_mb": peak_memory_mb(),
                "exports": exported,
                **scores,
            }
        )
    )
    for part in parts["reports"]:
        with blame(part.item):
            part.component.write(run.path, scene)


def describe(
    pipeline: Pipeline, scene: Scene, model: GaussianModel, iterations: int
) -> dict[str, Any]:
    """What was trained on what; the facts that open results.json.

    Args:
        iterations: that the Gaussians have been trained for.
    """
    return {
        "pipeline": pipeline.name,
        "scene": _describe_scene(scene),
        "device": describe_device(model.device),
        "seed": pipeline.training.seed,
        "iterations": iterations,
        "gaussians": model.count,
        "hash": model.digest(),
    }


def score(run: RunFolder, parts: Parts, scene: Scene, model: GaussianModel) -> dict[str, Any]:
    """Score both splits and picture the test views; the part of results.json that `eval` renews."""
    pictures = run.folder(RENDERS) if scene.test else None
    test = evaluate(model, scene, scene.test, parts["metrics"], pictures)
    train = evaluate(model, scene, scene.train, parts["metrics"])
    return {
        "test": test.mean,
        "train": train.mean,
        "views": {"test": test.views, "train": train.views},
    }


def results_table(results: dict[str, Any]) -> Table:
    """The scores of a results.json as a table: a row a test view, then the means."""
    metrics = list(results["train"])
    table = Table(title=f"{results['scene']['name']}, {results['pipeline']}")
    table.add_column("view")
    for name in metrics:
        table.add_column(name, justify="right")
    for view, row in results["views"]["test"].items():
        table.add_row(view, *(_number(row[name]) for name in metrics))
    table.add_section()
    for label, split in (("test mean", "test"), ("train mean", "train")):
        if results[split]:
            table.add_row(label, *(_number(results[split][name]) for name in metrics))
    return table


def _number(value: float | None) -> str:
    return "inf" if value is None else f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"


def _describe_scene(scene: Scene) -> dict[str, Any]:
    return {
        "name": scene.name,
        "train": [view.name for view in scene.train],
        "test": [view.name for view in scene.test],
        "width": scene.train[0].camera.width,
        "height": scene.train[0].camera.height,
        "extent": scene.extent,
        **scene.notes,
    }


def _inside(run: RunFolder, file: Path) -> str:
    """Relative to the run folder where possible, so that a run can be moved."""
    return str(file.relative_to(run.path)) if file.is_relative_to(run.path) else str(file)
