"""The end of a run: scores, pictures, exports, reports, results.json."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from core_rasterizer import GaussianModel

from ..contract.scene import Scene
from ..pipeline.blame import blame
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Item, Pipeline
from .average_error import AVERAGE_ERROR
from .evaluation import averaged, evaluate
from .folder import RunFolder
from .memory import peak_memory_mb
from .metrics_log import jsonable
from .provenance import describe_device

RENDERS = "renders"
EXPORTS = "exports"
ABSENT = "\u2013"
"""What tables show, a dash, where a score is not available."""


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
    results = jsonable(
        {
            **describe(pipeline, scene, model, iterations),
            "initialization": run.initialization(),
            "seconds": round(seconds, 3),
            "iterations_per_second": round(iterations / max(seconds, 1e-9), 3),
            "peak_memory_mb": peak_memory_mb(),
            "exports": exported,
            "reports": [],
            "changed_inputs": run.inputs()[1],
            **scores,
        }
    )
    run.write_results(results)  # reports read it
    for part in parts["reports"]:
        with blame(part.item):
            written = part.component.write(run.path, scene)
        results["reports"] += [_inside(run, file) for file in written]
    run.write_results(results)


def describe(
    pipeline: Pipeline, scene: Scene, model: GaussianModel, iterations: int
) -> dict[str, Any]:
    """What was trained on what; the facts that open results.json.

    Args:
        iterations: that the Gaussians have been trained for.
    """
    return {
        "pipeline": pipeline.name,
        "protocol": pipeline.protocol.record() if pipeline.protocol else None,
        "scene": _describe_scene(scene),
        "metrics": _describe_metrics(pipeline.items["metrics"]),
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
        "unavailable": {**train.unavailable, **test.unavailable},
    }


def results_table(results: dict[str, Any]) -> Table:
    """The scores of a results.json as a table: a row a test view, then the means."""
    metrics = list(results["train"] | results["test"])
    missing: dict[str, str] = results["unavailable"]
    table = Table(
        title=f"{results['scene']['name']}, {results['pipeline']}",
        caption="\n".join(f"{ABSENT} {name}: {reason}" for name, reason in missing.items()) or None,
    )
    table.add_column("view")
    for name in metrics:
        table.add_column(name, justify="right")

    def add(label: str, row: dict[str, float | None]) -> None:
        table.add_row(label, *(_cell(row, name, missing) for name in metrics))

    for view, row in results["views"]["test"].items():
        add(view, row)
    table.add_section()
    for label, split in (("test mean", "test"), ("train mean", "train")):
        if results[split]:
            add(label, results[split])
    return table


def _cell(row: dict[str, float | None], name: str, missing: dict[str, str]) -> str:
    value = row.get(name)
    if value is None and (name not in row or name in missing):
        return ABSENT
    return _score(value)


def _score(value: float | None) -> str:
    """A score to four digits; None is infinite, for which JSON has no number."""
    return "inf" if value is None else f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"


def _describe_scene(scene: Scene) -> dict[str, Any]:
    """What the host sees, then the loader's facts: those that scores depend on, and the others."""
    camera, views = scene.train[0].camera, (*scene.train, *scene.test)
    return {
        "name": scene.name,
        "train": [view.name for view in scene.train],
        "test": [view.name for view in scene.test],
        "width": camera.width,
        "height": camera.height,
        "background": list(scene.background),
        "extent": scene.extent,
        "near": scene.bounds[0],
        "far": scene.bounds[1],
        "points": len(scene.points) if scene.points is not None else 0,
        "image_memory_mb": round(sum(view.image.nbytes for view in views) / 1e6, 1),
        "facts": {fact.name: fact.value for fact in scene.facts if fact.affects_scores},
        "notes": {fact.name: fact.value for fact in scene.facts if not fact.affects_scores},
    }


def _describe_metrics(items: Sequence[Item]) -> dict[str, Any]:
    described: dict[str, Any] = {item.name: _describe_metric(item) for item in items}
    parts = averaged(items)
    if parts:
        described.setdefault(AVERAGE_ERROR, {"of": [_describe_metric(item) for item in parts]})
    return described


def _describe_metric(item: Item) -> dict[str, Any]:
    """What the scores depend on: not where a file lies, its hash says what it holds."""
    settings = item.settings.model_dump(mode="json")
    paths = [name for name, value in item.settings if isinstance(value, Path)]
    return {"use": item.offer.name, **{k: v for k, v in settings.items() if k not in paths}}


def _inside(run: RunFolder, file: Path) -> str:
    """Relative to the run folder where possible, so that a run can be moved."""
    return str(file.relative_to(run.path)) if file.is_relative_to(run.path) else str(file)
