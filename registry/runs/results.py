"""Contents of results.json: what was trained on what, and its scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from core_rasterizer import ExplainedError, GaussianModel

from ..contract.scene import Scene
from ..errors import PluginError
from ..pipeline.pipeline import Item, Pipeline
from ..system.files import jsonable
from .evaluation import AVERAGE_ERROR, Scores, averaged
from .origin import describe_device
from .results_file import Failure, Results, SceneRecord, ViewScores

RENDERS = "renders"
EXPORTS = "exports"


def describe(pipeline: Pipeline, scene: Scene, model: GaussianModel, iteration: int) -> Results:
    """Return results with what was trained on what, without scores and times."""
    protocol = pipeline.protocol
    return Results(
        pipeline=pipeline.name,
        protocol=protocol.record() if protocol else None,
        scene=_scene(scene),
        metrics=_metrics(pipeline.items["metrics"]),
        device=describe_device(model.device),
        seed=pipeline.training.seed,
        iterations=iteration,
        gaussians=model.count,
        hash=model.digest(),
    )


def add_scores(results: Results, test: Scores, train: Scores) -> None:
    """Set the scores of both splits, and the failures of metrics."""
    results.test = jsonable(test.mean)
    results.train = jsonable(train.mean)
    results.views = ViewScores(test=jsonable(test.views), train=jsonable(train.views))
    results.unavailable = {**train.unavailable, **test.unavailable}
    results.infinite = {"test": test.infinite, "train": train.infinite}
    failures = {**train.failures, **test.failures}
    results.failures = [failure(name, error) for name, error in failures.items()]


def failure(component: str, error: ExplainedError) -> Failure:
    """Return the record of a component that failed after training."""
    return Failure(component=component, what=error.what, where=error.where, fix=error.fix)


def existing_files(answer: Any) -> list[Path]:
    """Return the paths that an exporter or a report returned.

    Raises:
        PluginError: the answer is not a list of paths of files that exist.
    """
    if not isinstance(answer, list | tuple) or not all(isinstance(file, Path) for file in answer):
        raise PluginError(f"the answer is {answer!r}, expected a list of paths")
    missing = [file for file in answer if not file.is_file()]
    if missing:
        raise PluginError(f"it returned {missing[0]}, but there is no such file")
    return list(answer)


def _scene(scene: Scene) -> SceneRecord:
    camera, views = scene.train[0].camera, (*scene.train, *scene.test)
    facts = jsonable({fact.name: fact.value for fact in scene.facts if fact.affects_scores})
    notes = jsonable({fact.name: fact.value for fact in scene.facts if not fact.affects_scores})
    return SceneRecord(
        name=scene.name,
        train=[view.name for view in scene.train],
        test=[view.name for view in scene.test],
        width=camera.width,
        height=camera.height,
        background=list(scene.background),
        extent=scene.extent,
        near=scene.bounds[0],
        far=scene.bounds[1],
        points=len(scene.points) if scene.points is not None else 0,
        image_memory_mb=round(sum(view.image.nbytes for view in views) / 1e6, 1),
        facts=facts,
        notes=notes,
    )


def _metrics(items: Sequence[Item]) -> dict[str, Any]:
    described: dict[str, Any] = {item.name: _metric(item) for item in items}
    parts = averaged(items)
    if parts:
        described.setdefault(AVERAGE_ERROR, {"of": [_metric(item) for item in parts]})
    return jsonable(described)  # type: ignore[no-any-return]


def _metric(item: Item) -> dict[str, Any]:
    """Return the settings that scores depend on: the hash of a file, but not its path."""
    settings = item.settings.model_dump(mode="json")
    paths = [name for name, value in item.settings if isinstance(value, Path)]
    return {"use": item.offer.name, **{k: v for k, v in settings.items() if k not in paths}}
