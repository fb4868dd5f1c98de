"""The end of a run: scores, pictures, exports, reports, results.json."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.scene import Scene
from ..files import jsonable
from ..memory import peak_memory_mb
from ..pipeline.blame import blame
from ..pipeline.pipeline import Item
from .average_error import AVERAGE_ERROR
from .evaluation import averaged
from .folder import RunFolder
from .origin.provenance import describe_device

if TYPE_CHECKING:
    from .run import Run

RENDERS = "renders"
EXPORTS = "exports"


def finish(run: Run) -> None:
    """Evaluate, export, write results.json, and let the reports do their work, all in its folder."""
    folder = run.folder_or_refuse()
    scores = score(run)
    exported: list[str] = []
    for part in run.parts["exporters"]:
        with blame(part.item):
            written = part.component.export(run.model, run.scene, folder.folder(EXPORTS))
        exported += [_inside(folder, file) for file in written]
    stages = run.seconds.rounded()
    results = jsonable(
        {
            **describe(run),
            "initialization": run.initialization,
            "seconds": stages["training"],
            "seconds_total": round(sum(stages.values()), 3),
            "stages": stages,
            "iterations_per_second": round(run.iteration / max(run.seconds.training, 1e-9), 3),
            "peak_memory_mb": peak_memory_mb(),
            "exports": exported,
            "reports": [],
            "changed_inputs": folder.inputs()[1],
            **scores,
        }
    )
    folder.write_results(results)  # reports read it
    for part in run.parts["reports"]:
        with blame(part.item):
            written = part.component.write(folder.path, run.scene)
        results["reports"] += [_inside(folder, file) for file in written]
    folder.write_results(results)


def renew(run: Run) -> dict[str, Any]:
    """Score a run anew where it stands, in its results.json and its pictures; returns the results."""
    folder = run.folder_or_refuse()
    run.keep_changes()
    changed = {"changed_inputs": folder.inputs()[1]}
    results: dict[str, Any] = jsonable(
        {**folder.results(), **describe(run), **changed, **score(run)}
    )
    folder.write_results(results)
    return results


def describe(run: Run) -> dict[str, Any]:
    """What was trained on what; the facts that open results.json."""
    pipeline, scene = run.pipeline, run.scene
    return {
        "pipeline": pipeline.name,
        "protocol": pipeline.protocol.record() if pipeline.protocol else None,
        "scene": _describe_scene(scene),
        "metrics": _describe_metrics(pipeline.items["metrics"]),
        "device": describe_device(run.model.device),
        "seed": pipeline.training.seed,
        "iterations": run.iteration,
        "gaussians": run.model.count,
        "hash": run.hash,
    }


def score(run: Run) -> dict[str, Any]:
    """Score both splits and picture the test views; the part of results.json that `eval` renews."""
    scores = run.evaluate(run.folder_or_refuse().folder(RENDERS) if run.scene.test else None)
    test, train = scores["test"], scores["train"]
    return {
        "test": test.mean,
        "train": train.mean,
        "views": {"test": test.views, "train": train.views},
        "unavailable": {**train.unavailable, **test.unavailable},
    }


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


def _inside(folder: RunFolder, file: Path) -> str:
    """Relative to the run folder where possible, so that a run can be moved."""
    return str(file.relative_to(folder.path)) if file.is_relative_to(folder.path) else str(file)
