"""What a run leaves in its folder at its end: scores, pictures, exports, reports and results.json."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any

from core_rasterizer import ExplainedError

from ..calls.copies import copied
from ..errors import RunError
from ..pipeline.parts import Part
from ..system.files import jsonable
from ..system.memory import peak_memory_mb
from ..toolkit.progress import progress
from .folder import RunFolder
from .origin import (
    changed_inputs,
    input_digests,
    listed,
    refuse_changed_plugins,
    with_packages,
)
from .results import EXPORTS, RENDERS, Failure, Results, add_scores, describe
from .trained_scene import TrainedScene

_log = logging.getLogger(__name__)


def finish(run: TrainedScene, folder: RunFolder) -> None:
    """Evaluate, write results.json, export and report, all in the run folder.

    If a metric, an exporter or a report fails, the others still run; the results list the failures.
    """
    _refuse_overwritten_inputs(run, folder)
    before, results = folder.results(), _scored(run, folder, {})
    hash_before = before.get("hash", results.hash)
    if before.get("iterations") == results.iterations and hash_before != results.hash:
        _log.warning("the hash was %s when the run was finished before", hash_before)
    results.peak_memory_mb = peak_memory_mb()
    begin = monotonic()
    _write_with_outputs(run, folder, results)
    run.seconds.outputs = monotonic() - begin
    _add_times(run, results)
    folder.write_results(results)


def renew(
    run: TrainedScene, folder: RunFolder, *, accept_changed_plugins: bool = False
) -> dict[str, Any]:
    """Score the run again, renew its results.json and pictures, and return the results.

    For a finished run, export and report again too. Refuses a results.json of a later iteration, and
    metrics that are missing, or that have changed unless `accept_changed_plugins`.
    """
    with folder.locked():
        before = folder.results()
        packages = {**folder.plugins, **before.get("packages", {})}
        for name, error in run.pipeline.missing.items():
            if name.startswith("metrics."):
                raise with_packages(error, packages)
        metrics = run.pipeline.items["metrics"]
        refuse_changed_plugins(packages, metrics, folder.path, accept=accept_changed_plugins)
        recorded = before.get("iterations", 0)
        if recorded > run.iteration:
            raise RunError(
                f"results.json is of iteration {recorded}, the newest intact checkpoint of "
                f"{run.iteration}",
                where=str(folder.path),
                fix=f"train to the end again: stereogs resume {folder.path}",
            )
        record_changed_inputs(run, folder)
        results = _scored(run, folder, before)
        if run.finished:
            _write_with_outputs(run, folder, results)
        else:
            folder.write_results(results)
    return results.plain()


def write_reports(
    run: TrainedScene, folder: RunFolder, reports: Sequence[Part]
) -> tuple[list[str], list[Failure]]:
    """Write reports about the finished run, whether or not its pipeline names them.

    Returns:
        The files, relative to the run folder, and the failures. The files are added to results.json.
    """
    with folder.locked():
        files, failures = _report(run, folder, reports)
        results = Results.model_validate(folder.results())
        results.reports = list(dict.fromkeys([*results.reports, *files]))
        folder.write_results(results)
    return files, failures


def record_changed_inputs(run: TrainedScene, folder: RunFolder) -> None:
    """Write to inputs.json which inputs have changed; called before the first output from them."""
    before, _ = folder.inputs()
    now = input_digests(run.scene, run.pipeline)
    if before is not None and (changed := changed_inputs(before, now)):
        folder.write_inputs(now, changed)


def _refuse_overwritten_inputs(run: TrainedScene, folder: RunFolder) -> None:
    """Refuse to score with photographs or cameras that a component overwrote, unseen by the guards."""
    before, _ = folder.inputs()
    changed = changed_inputs(before or {}, input_digests(run.scene, run.pipeline))
    if before and changed:
        folder.write_inputs(before, changed)  # results of `eval` list them
        raise RunError(
            f"a component wrote into the inputs during training: {listed(changed)}",
            where=str(folder.path),
            fix="train again with --check-plugins, which names the component",
        )


def _scored(run: TrainedScene, folder: RunFolder, before: dict[str, Any]) -> Results:
    """Score both splits, draw pictures into the folder (`evaluate`), and return updated results."""
    described = describe(run)
    results = Results.model_validate({**before, **described.plain()})
    results.packages = {**before.get("packages", {}), **results.packages}
    results.changed_inputs = folder.inputs()[1]
    scores = run.evaluate(folder.folder(RENDERS))
    add_scores(results, **scores)
    if not before:
        results.initialization = jsonable(run.initialization)
        per_second = run.iteration / max(run.seconds.training, 1e-9)
        results.iterations_per_second = round(per_second, 3)
        _add_times(run, results)
    return results


def _add_times(run: TrainedScene, results: Results) -> None:
    results.stages = run.seconds.rounded()
    results.seconds = results.stages["training"]
    results.seconds_total = round(sum(results.stages.values()), 3)


def _write_with_outputs(run: TrainedScene, folder: RunFolder, results: Results) -> None:
    """Write results.json before anything else can fail; then export, report, and write it again."""
    results.exports, results.reports = [], []
    folder.write_results(results)
    exporters = run.parts["exporters"]
    place = folder.folder(EXPORTS) if exporters else folder.path
    progress("files")
    results.exports, failures = _outputs(
        folder,
        exporters,
        lambda: (run.exported, copied(run.scene), place),
    )
    results.failures += failures
    folder.write_results(results)  # for the reports
    results.reports, failures = _report(run, folder, run.parts["reports"])
    results.failures += failures
    folder.write_results(results)


def _report(
    run: TrainedScene, folder: RunFolder, reports: Sequence[Part]
) -> tuple[list[str], list[Failure]]:
    progress("page")
    return _outputs(folder, reports, lambda: (folder.path, copied(run.trained_on)))


def _outputs(
    folder: RunFolder, parts: Sequence[Part], given: Callable[[], tuple[Any, ...]]
) -> tuple[list[str], list[Failure]]:
    """Return the files that components wrote, relative to the folder where possible, and failures.

    Args:
        given: returns new arguments for a component.
    """
    root, files, failures = folder.path, list[str](), list[Failure]()
    for part in parts:
        try:
            written = part.call(*given())
        except ExplainedError as error:
            failures.append(Failure.of(part.item.qualified_name, error))
        else:
            files += [
                f.relative_to(root).as_posix() if f.is_relative_to(root) else str(f)
                for f in written
            ]
    return files, failures
