"""results.json: what was trained on what, and its scores. One model writes and reads it.

A run folder may come from an untrusted source, so reading checks types, ranges and consistency.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from core_rasterizer import ExplainedError

from ..errors import RunError
from ..messages.visible_text import visible, without_credentials
from ..pipeline.protocols import scored
from ..pipeline.settings_check import recorded
from ..system.files import jsonable

if TYPE_CHECKING:
    from ..contract.scene import Scene
    from ..pipeline.pipeline import Item
    from .evaluation import Scores
    from .trained_scene import TrainedScene

RENDERS = "renders"
EXPORTS = "exports"
_LARGEST = 12_000_000
"""Bytes; the scores of 10,000 views take 2 MB."""
_TOLERANCE = 1e-6
"""Relative difference between a mean and that of the views, from rounding."""

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=500)]
Score = Number | None
"""None: infinite or not available."""
ScoresByMetric = dict[Name, Score]


class Record(BaseModel):
    """A part of the file. Versions write different fields, so unknown ones are allowed."""

    model_config = ConfigDict(extra="allow")


class _Protocol(Record):
    name: Name
    modified: dict[str, Any]


def _checked_protocol(value: dict[str, Any]) -> dict[str, Any]:
    _Protocol.model_validate(value, strict=True)
    return value


class SceneRecord(Record):
    """The scene; `facts` affect scores, `notes` do not."""

    name: Name
    train: list[Name] = []
    test: list[Name] = []
    width: Count = 0
    height: Count = 0
    background: list[Number] = []
    extent: Amount = 0.0
    near: Amount = 0.0
    far: Amount = 0.0
    points: Count = 0
    image_memory_mb: Amount = 0.0
    facts: dict[Name, Any] = {}
    notes: dict[Name, Any] = {}


class ViewScores(Record):
    """Scores of each view, by split."""

    test: dict[Name, ScoresByMetric] = {}
    train: dict[Name, ScoresByMetric] = {}


class Failure(Record):
    """A metric, exporter or report that failed after training."""

    component: Name
    what: str
    where: str = ""
    fix: str = ""

    @staticmethod
    def of(component: str, error: ExplainedError) -> Failure:
        """Return the record of an error."""
        texts = {name: _shown(getattr(error, name)) for name in ("what", "where", "fix")}
        return Failure(component=component, **texts)


def _shown(text: str) -> str:
    return without_credentials(visible(text))


class Recovery(Record):
    """A return to a checkpoint because a parameter was not finite (`--recover`).

    Args:
        iteration: in which it was found.
        back_to: iteration of the checkpoint.
        rates: factor of the learning rates from there on.
        error: which parameter.
    """

    iteration: Count
    back_to: Count
    rates: Amount
    error: str


class HandEdit(Record):
    """Gaussians that a person removed from another run.

    Args:
        run, folder: identifier and name of the other run.
        hash: of its Gaussians.
        gaussians: their number.
        removed: how many were removed.
        by: the program.
    """

    run: str
    folder: str
    hash: str
    gaussians: Count
    removed: Count
    by: str


class Results(Record):
    """Contents of the file, in order. A file may lack fields; `model_fields_set` holds those it has.

    `train_scored` is the number of training views that were scored, if they were not all (`scored`).
    """

    pipeline: Name = "unnamed"
    protocol: Annotated[dict[str, Any], AfterValidator(_checked_protocol)] | None = None
    scene: SceneRecord | None = None
    metrics: dict[Name, dict[str, Any]] = {}
    packages: dict[Name, str] = {}
    device: dict[Name, str] = {}
    seed: int = 0
    iterations: Count = 0
    gaussians: Count = 0
    hash: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] = "0" * 64
    initialization: dict[Name, Any] = {}
    seconds: Amount = 0.0
    seconds_total: Amount = 0.0
    stages: dict[Name, Amount] = {}
    iterations_per_second: Amount = 0.0
    peak_memory_mb: Amount | None = None
    changed_inputs: list[Name] = []
    recoveries: list[Recovery] = []
    edits: list[HandEdit] = []
    test: ScoresByMetric = {}
    train: ScoresByMetric = {}
    views: ViewScores = ViewScores()
    train_scored: Count = 0
    unavailable: dict[Name, str] = {}
    infinite: dict[Name, dict[Name, list[Name]]] = {}
    failures: list[Failure] = []
    exports: list[str] = []
    reports: list[str] = []

    def plain(self) -> dict[str, Any]:
        """Return the fields that are set, as JSON values."""
        return self.model_dump(exclude_unset=True)


def describe(run: TrainedScene) -> Results:
    """Return results with what was trained on what, without scores and times."""
    from .origin import describe_device, foreign_package

    pipeline, model = run.pipeline, run.engine_model
    packages = {item.qualified_name: foreign_package(item.offer) for item in pipeline}
    results = Results(
        pipeline=pipeline.name,
        protocol=pipeline.protocol.record() if pipeline.protocol else None,
        scene=_scene(run.scene),
        metrics=_metrics(pipeline.items["metrics"]),
        packages={name: package for name, package in packages.items() if package},
        device=describe_device(model.engine.device),
        seed=pipeline.training.seed,
        iterations=run.iteration,
        gaussians=model.count,
        hash=run.hash,
    )
    if run.recoveries:
        results.recoveries = [Recovery.model_validate(found) for found in run.recoveries]
    if run.edits:
        results.edits = [HandEdit.model_validate(found) for found in run.edits]
    return results


def _scene(scene: Scene) -> SceneRecord:
    camera, views = scene.train[0].camera, (*scene.train, *scene.test)
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
        facts=jsonable({fact.name: fact.value for fact in scene.facts if fact.affects_scores}),
        notes=jsonable({fact.name: fact.value for fact in scene.facts if not fact.affects_scores}),
    )


def _metrics(items: Sequence[Item]) -> dict[str, Any]:
    from .evaluation import AVERAGE_ERROR, averaged

    described: dict[str, Any] = {item.name: _metric(item) for item in items}
    parts = averaged(items)
    if parts:
        described.setdefault(AVERAGE_ERROR, {"of": [_metric(item) for item in parts]})
    return jsonable(described)  # type: ignore[no-any-return]


def _metric(item: Item) -> dict[str, Any]:
    """Return what scores depend on: the package, the settings, the hash of a file, but not its path."""
    from .origin import foreign_package

    settings = recorded(item.settings)
    paths = [name for name, value in item.settings if isinstance(value, Path)]
    kept = {k: v for k, v in settings.items() if k not in paths}
    package = foreign_package(item.offer)
    return {"use": item.offer.name, **({"package": package} if package else {}), **kept}


def add_scores(results: Results, test: Scores, train: Scores) -> None:
    """Set the scores of both splits, and the failures of metrics."""
    results.test = jsonable(test.mean)
    results.train = jsonable(train.mean)
    results.views = ViewScores(test=jsonable(test.views), train=jsonable(train.views))
    results.unavailable = {**train.unavailable, **test.unavailable}
    if results.scene is not None and len(train.views) < len(results.scene.train):
        results.train_scored = len(train.views)
    results.infinite = {"test": test.infinite, "train": train.infinite}
    failures = {**train.failures, **test.failures}
    results.failures = [Failure.of(name, error) for name, error in failures.items()]


def read_results(path: Path) -> dict[str, Any]:
    """Read a results.json.

    Raises:
        RunError: the file is missing, larger than 12 MB or not a JSON object; a key is repeated; a field has
            a wrong type or range; a text has control characters; a mean differs from that of the views; or
            the scored views are not those of the scene.
    """
    try:
        if not path.is_file():
            raise ValueError("there is no such file")
        size = path.stat().st_size
        if size > _LARGEST:
            raise ValueError(f"it has {size:,} bytes, more than {_LARGEST:,}")
        content: Any = json.loads(path.read_bytes(), object_pairs_hook=_unique)
        # json refuses what pydantic's parser would accept; strict mode needs JSON text again.
        results = Results.model_validate_json(json.dumps(content), strict=True)
        if problem := next(_problems(results, content), None):
            raise ValueError(problem)
    except (OSError, ValueError, RecursionError) as error:
        raise RunError(
            f"{path.name} is inconsistent: {problem_of(error)}",
            where=str(path),
            fix=f"remove it, and score the run again: stereogs eval {path.parent}",
        ) from error
    return dict(content)


def score_of(
    results: Mapping[str, Any], split: str, metric: str, view: str | None = None
) -> float | None:
    """Return a view's score, or by default the mean; infinity, or None if not available, for null."""
    row = results[split] if view is None else results["views"][split].get(view, {})
    infinite = results.get("infinite", {}).get(split, {}).get(metric, [])
    found: float | None = row.get(metric)
    return math.inf if (infinite if view is None else view in infinite) else found


def problem_of(error: Exception) -> str:
    """Return what is wrong with a JSON file: the first wrong field, or the syntax."""
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "all of it"
        return f"{place}: {first['msg']}"
    return f"it is not JSON: {error}" if isinstance(error, json.JSONDecodeError) else str(error)


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse repeated keys: parsers differ in which value they keep."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is repeated")
    return found


def _problems(results: Results, content: Any) -> Iterator[str]:
    for text in _texts(content):
        if visible(text) != text:
            yield f"the text {text[:100]!r} has control characters"
    scene = results.scene or SceneRecord(name="none")
    some = scored(scene.train, scene.test) if results.train_scored else scene.train
    if results.train_scored not in (0, len(some)):
        yield f"train_scored is {results.train_scored}, not {len(some)}"
    for split, named in (("train", some), ("test", scene.test)):
        rows: dict[str, ScoresByMetric] = getattr(results.views, split)
        if named and "views" in results.model_fields_set and list(rows) != named:
            yield f"views.{split} are not the scene's {split} views"
        if rows:
            infinite = results.infinite.get(split, {})
            yield from _wrong_means(split, getattr(results, split), rows, infinite)


def _wrong_means(
    split: str,
    means: ScoresByMetric,
    rows: Mapping[str, ScoresByMetric],
    infinite: Mapping[str, Sequence[str]],
) -> Iterator[str]:
    names = dict.fromkeys(name for row in rows.values() for name in row)
    if names.keys() != means.keys():
        yield f"{split} has other metrics than its views"
        return
    for name in names:
        known = [s for row in rows.values() if (s := row.get(name)) is not None]
        expected = sum(known) / len(known) if known and not infinite.get(name) else None
        if expected is not None and not math.isfinite(expected):
            expected = None
        if not _equal(means[name], expected):
            yield f"{split}.{name} is {means[name]}, the mean of its views is {expected}"


def _equal(one: Score, other: Score) -> bool:
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=_TOLERANCE, abs_tol=1e-12)


def _texts(value: Any) -> Iterator[str]:
    """Yield every key and text in a JSON value."""
    children = [*value, *value.values()] if isinstance(value, dict) else value
    if isinstance(children, str):
        yield children
    elif isinstance(children, list):
        for child in children:
            yield from _texts(child)
