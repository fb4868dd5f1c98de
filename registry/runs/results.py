"""The end of a run: scores, pictures, exports, reports, results.json."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from core_rasterizer import ExplainedError

from ..calls.read_only_guard import Overwritten, ReadOnlyGuard, of_scene
from ..contract.scene import Scene
from ..errors import PluginError, RunError
from ..pipeline.parts import Part
from ..pipeline.pipeline import Item
from ..system.files import jsonable
from ..system.memory import peak_memory_mb
from .average_error import AVERAGE_ERROR
from .evaluation import averaged
from .folder import RunFolder
from .origin.provenance import describe_device

if TYPE_CHECKING:
    from .run import Run, Stages

RENDERS = "renders"
EXPORTS = "exports"

_log = logging.getLogger(__name__)


def finish(run: Run) -> None:
    """Evaluate, export, write results.json, and let the reports do their work, all in its folder.

    A metric, an exporter or a report that fails keeps no other from its work; "failures" in the results
    tell of it.
    """
    folder = run.folder_or_refuse()
    before = folder.results()
    scores = score(run)
    results = jsonable(
        {
            **describe(run),
            "initialization": run.initialization,
            **_times(run.seconds),
            "iterations_per_second": round(run.iteration / max(run.seconds.training, 1e-9), 3),
            "peak_memory_mb": peak_memory_mb(),
            "changed_inputs": folder.inputs()[1],
            **scores,
        }
    )
    if before.get("hash", results["hash"]) != results["hash"]:
        _log.warning("the hash was %s when the run was finished before", before["hash"])
    begin = monotonic()
    _write_with_outputs(run, results)
    run.seconds.outputs = monotonic() - begin
    folder.write_results(results | _times(run.seconds))


def _times(stages: Stages) -> dict[str, Any]:
    """Seconds of training, of everything, and of each stage."""
    rounded = stages.rounded()
    total = round(sum(rounded.values()), 3)
    return {"seconds": rounded["training"], "seconds_total": total, "stages": rounded}


def renew(run: Run) -> dict[str, Any]:
    """Score a run anew where it stands, in its results.json and its pictures; returns the results.

    Of a finished run the exports and reports are made anew too.

    Raises:
        RunError: another process works on the run; or results.json is of a later iteration.
    """
    folder = run.folder_or_refuse()
    with folder.to_itself():
        before = folder.results()
        recorded = before.get("iterations")
        if isinstance(recorded, int) and recorded > run.iteration:
            raise RunError(
                f"results.json is of iteration {recorded}, the newest whole checkpoint of {run.iteration}",
                where=str(folder.path),
                fix=f"train to the end again: stereogs resume {folder.path}",
            )
        run.keep_changes()
        changed = {"changed_inputs": folder.inputs()[1]}
        results: dict[str, Any] = jsonable({**before, **describe(run), **changed, **score(run)})
        if run.finished:
            _write_with_outputs(run, results)
        else:
            folder.write_results(results)
    return results


def check_recorded_hash(recorded: Mapping[str, Any], digest: str, path: Path) -> None:
    """Refuse Gaussians that are not those whose scores results.json holds.

    Args:
        recorded: what it holds, of the same iteration; empty if there is none.
        digest: of the checkpoint's Gaussians.
        path: the run folder.

    Raises:
        RunError: the hashes differ.
    """
    if recorded.get("hash", digest) != digest:
        raise RunError(
            f"the Gaussians of the checkpoint, {digest[:12]}..., are not those that results.json "
            f"was written for, {str(recorded['hash'])[:12]}...",
            where=str(path),
            fix="bring the changed file back; or, if the checkpoint is right, remove results.json "
            f"and call `stereogs eval {path}`",
        )


def _write_with_outputs(run: Run, results: dict[str, Any]) -> None:
    """Write results.json, before anything else can fail; then export, report, and write it again."""
    folder = run.folder_or_refuse()
    results |= {"exports": [], "reports": []}
    folder.write_results(results)
    lent = of_scene(run.scene) + ReadOnlyGuard(models=(run.model,))
    for part in run.parts["exporters"]:
        place = folder.folder(EXPORTS)
        export = partial(part.component.export, run.model.reader(), run.scene, place)
        results["exports"] += _written(part, lent, folder, results["failures"], export)
    folder.write_results(results)  # reports read it
    results["reports"] += _report(run, run.parts["reports"], results["failures"])
    folder.write_results(results)


def report(run: Run, reports: Sequence[Part]) -> tuple[list[str], list[dict[str, str]]]:
    """Let reports write about a finished run, whether or not its pipeline names them.

    Returns:
        The files, relative to the run's folder, which results.json then names too; and what failed.

    Raises:
        RunError: another process works on the run.
    """
    folder = run.folder_or_refuse()
    failures: list[dict[str, str]] = []
    with folder.to_itself():
        files = _report(run, reports, failures)
        results = folder.results()
        results["reports"] = list(dict.fromkeys([*results.get("reports", []), *files]))
        folder.write_results(results)
    return files, failures


def _report(run: Run, reports: Sequence[Part], failures: list[dict[str, str]]) -> list[str]:
    folder = run.folder_or_refuse()
    files: list[str] = []
    for part in reports:
        write = partial(part.component.write, folder.path, run.scene)
        files += _written(part, of_scene(run.scene), folder, failures, write)
    return files


def _written(
    part: Part,
    lent: ReadOnlyGuard,
    folder: RunFolder,
    failures: list[dict[str, str]],
    write: Callable[[], Any],
) -> list[str]:
    """The files that an exporter or a report has written; none, and a failure noted, if it failed."""
    try:
        with part.at_work(lent=lent):
            return [_inside(folder, file) for file in existing_files(write())]
    except Overwritten:
        raise
    except ExplainedError as error:
        failures.append(_told(part.item.qualified_name, error))
        return []


def existing_files(answer: Any) -> list[Path]:
    """What an exporter or a report says it wrote: paths of files that are there."""
    if not isinstance(answer, list | tuple) or not all(isinstance(file, Path) for file in answer):
        raise PluginError(f"the answer is {answer!r}, expected a list of paths")
    missing = [file for file in answer if not file.is_file()]
    if missing:
        raise PluginError(f"it says that it wrote {missing[0]}, and there is no such file")
    return list(answer)


def _told(component: str, error: ExplainedError) -> dict[str, str]:
    return {"component": component, "what": error.what, "where": error.where, "fix": error.fix}


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
    failures = {**train.failures, **test.failures}
    return {
        "test": test.mean,
        "train": train.mean,
        "views": {"test": test.views, "train": train.views},
        "unavailable": {**train.unavailable, **test.unavailable},
        "infinite": {"test": test.infinite, "train": train.infinite},
        "failures": [_told(name, error) for name, error in failures.items()],
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
