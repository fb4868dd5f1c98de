"""Runs and failed iterations, read back from their folders.

RUN/failures/iteration-0000021/ is the checkpoint before iteration 21, with the error of that iteration. It is
created after the failure: training is repeated from the newest checkpoint up to the iteration before.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from difflib import SequenceMatcher
from pathlib import Path
from time import monotonic
from typing import Any

from core_rasterizer import Device, Engine, ExplainedError, Gaussians

from ..contract.checks.scene import validate
from ..contract.hook_points import HOOK_POINTS
from ..contract.scene import Scene
from ..discovery import Plugins
from ..errors import RunError
from ..pipeline.parts import Parts, load_scene
from ..pipeline.pipeline import load_pipeline
from ..pipeline.yaml_source import parse
from ..training.assembly import restore
from ..training.checkpoint import (
    CHECKPOINT,
    EDITS,
    RECOVERIES,
    Checkpoint,
    explain_misfit,
    load_checkpoint,
    rates_after,
    write_checkpoint,
)
from ..training.initial_model import new_model
from .folder import RunFolder
from .origin import input_digests, refuse_changed_inputs, with_packages
from .run import Run
from .sources.cameras import scene_of
from .sources.places import in_its_place
from .trained_scene import Stages

_OBSERVED = [point.section for point in HOOK_POINTS if point.observes]
"""Sections that may change before a run is resumed: no bit depends on them."""
_SCORING = ("metrics", "exporters", "reports")
FAILURES = "failures"
_log = logging.getLogger(__name__)


def load_run(
    path: Path,
    *,
    plugins: Plugins,
    device: Device | Engine,
    scene: Scene | Path | None = None,
    accept_changed_inputs: bool = False,
    to_train: bool = True,
    photographs: bool = True,
) -> Run:
    """Read a run folder: its pipeline, scene and newest checkpoint.

    Args:
        scene: used instead of the scene that the pipeline loads; or the folder that its loader reads.
        to_train: whether all components must be installed; otherwise only the scene's loader.
        photographs: False if the cameras are enough where the photographs cannot be loaded.

    Raises:
        ExplainedError: one of them cannot be read; the pipeline or the checkpoint belongs to another run; or
            the scene or a model file has changed, and `accept_changed_inputs` is False.
    """
    folder = RunFolder.existing(path)
    try:
        needed = None if to_train else ("scene",)
        pipeline = load_pipeline(folder.pipeline, plugins, needed=needed)
    except ExplainedError as error:
        raise with_packages(error, folder.plugins) from None
    for name, missing in pipeline.missing.items():
        if name.partition(".")[0] in _SCORING:
            _log.warning("%s is left out: %s", name, missing.what)
    place = path / CHECKPOINT
    checkpoint = load_checkpoint(place)
    if "" not in (folder.identity, checkpoint.run) and folder.identity != checkpoint.run:
        raise RunError(
            "the checkpoint belongs to another run",
            where=str(place),
            fix="restore the run's own checkpoint; provenance.json and manifest.json name the run",
        )
    _check_unedited(folder.pipeline, checkpoint.pipeline)
    if checkpoint.iteration > pipeline.training.iterations:
        raise RunError(
            f"the checkpoint is of iteration {checkpoint.iteration}, "
            f"but the run has {pipeline.training.iterations}",
            where=str(place),
            fix="restore the run's own checkpoint, or train again into another folder",
        )
    pipeline = in_its_place(pipeline, folder, scene if isinstance(scene, Path) else None)
    parts = Parts(pipeline, device)
    begin = monotonic()
    with nullcontext() if to_train else _without_advice():
        scene, complete = _scene_of(scene, parts, folder, photographs)
    loading = monotonic() - begin
    before, _ = folder.inputs()
    if before is not None and complete and not accept_changed_inputs:
        refuse_changed_inputs(before, scene, pipeline, path)
    facts = folder.initialization()
    with explain_misfit(place):
        gaussians = Gaussians(**checkpoint.part("model"))
        model = new_model(gaussians, pipeline.training, device)
    run = Run(
        pipeline,
        parts,
        scene,
        model,
        checkpoint.frame,
        checkpoint=lambda: checkpoint,
        iteration=checkpoint.iteration,
        initialization=facts,
        seconds=Stages(loading, float(facts.get("seconds", 0.0)), checkpoint.seconds),
        folder=folder,
        saved_iteration=checkpoint.iteration,
        photographs=complete,
        recoveries=list(checkpoint.notes.get(RECOVERIES, [])),
        edits=list(checkpoint.notes.get(EDITS, [])),
    )
    _check_hash(folder, run.iteration, run.hash)
    return run


def _scene_of(
    given: Scene | Path | None, parts: Parts, folder: RunFolder, photographs: bool
) -> tuple[Scene, bool]:
    """Return the scene of a run, and whether it has its photographs."""
    if isinstance(given, Scene):
        return validate(given), True
    try:
        return load_scene(parts.one("scene")), True
    except ExplainedError as error:
        remedy = "if the data was moved, add `--scene FOLDER`"
        error.fix = f"{error.fix}; {remedy}" if error.fix else remedy
        known = {} if photographs or given is not None else folder.cameras()
        if not known:
            raise
        _log.info("the photographs cannot be loaded, and are not needed: %s", error.what)
        return scene_of(known, error), False


@contextmanager
def _without_advice() -> Iterator[None]:
    """Print no lines about the photographs: training has printed them, and they advise how to train."""
    before = logging.root.manager.disable
    logging.disable(max(before, logging.WARNING))
    try:
        yield
    finally:
        logging.disable(before)


def _check_hash(folder: RunFolder, iteration: int, digest: str) -> None:
    """Refuse Gaussians that differ from those that results.json was written for."""
    results = folder.results()
    recorded = results.get("hash", digest)
    if results.get("iterations") == iteration and recorded != digest:
        raise RunError(
            f"the Gaussians of the checkpoint, {digest[:12]}..., are not those that results.json "
            f"was written for, {recorded[:12]}...",
            where=str(folder.path),
            fix="restore the changed file; or, if the checkpoint is right, remove results.json "
            f"and call `stereogs eval {folder.path}`",
        )


def _check_unedited(file: Path, before: str) -> None:
    """Refuse changes of the pipeline since training, except of comments, layout and observers."""
    text = file.read_text("utf-8")
    if text == before or _values(text) == _values(before):
        return
    number, written, was = _first_change(before.splitlines(), text.splitlines())
    raise RunError(
        f"the pipeline was edited after training began: {written} in place of {was}",
        where=f"{file}:{number}",
        fix="restore that line, or train the changed pipeline into another folder",
    )


def _values(text: str) -> dict[str, Any]:
    """Return the values of a pipeline without its observers; plugins may be uninstalled."""
    values = parse(text, "pipeline").as_written()
    return {name: value for name, value in values.items() if name not in _OBSERVED}


def _first_change(before: list[str], now: list[str]) -> tuple[int, str, str]:
    """Return the 1-based line of the first change that is not a comment, the new and the old content."""
    changes = SequenceMatcher(None, before, now, autojunk=False).get_opcodes()
    for kind, first, last, begin, end in changes:
        written, was = _content(now[begin:end]), _content(before[first:last])
        if kind != "equal" and written != was:
            return begin + 1, _quoted(written), _quoted(was)
    return 1, "nothing", "nothing"  # equal lines that today's plugins read differently


def _content(lines: list[str]) -> list[str]:
    return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _quoted(lines: list[str]) -> str:
    return f"`{lines[0]}`" if lines else "nothing"


def keep_failure(run: Run, iteration: int, error: Exception) -> None:
    """Keep the checkpoint before a failed iteration, and add the replay command to the `fix` of the error.

    If training cannot be repeated up to there, keep the newest checkpoint. Without a run folder, do nothing.
    """
    if run.folder is None:
        return
    try:
        newest = load_checkpoint(run.folder.path / CHECKPOINT)
        before = _train_until(iteration - 1, newest, run)
        notes = {
            "iteration": iteration,
            "what": error.what if isinstance(error, ExplainedError) else repr(error),
            "inputs": input_digests(run.scene, run.pipeline),
            RECOVERIES: run.recoveries,
        }
        place = run.folder.folder(FAILURES) / f"iteration-{iteration:07d}"
        shutil.rmtree(place, ignore_errors=True)  # the same iteration, failed before
        write_checkpoint(replace(before, notes=notes), place)
    except Exception as second:  # the first error is reported, whatever this one is
        _log.warning("the checkpoint before the failure could not be kept: %s", second)
        return
    if isinstance(error, ExplainedError):
        error.fix += f"{'; ' if error.fix else ''}`stereogs replay {place}` repeats the iteration"


def _train_until(last: int, newest: Checkpoint, run: Run) -> Checkpoint:
    """Return the checkpoint after iteration `last`, or `newest` if repeated training fails earlier."""
    if newest.iteration == last:
        return newest
    _log.info(
        "repeating from iteration %d to keep the checkpoint before the failure",
        newest.iteration + 1,
    )
    parts = Parts(run.pipeline, run.engine_model.engine)
    trainer = restore(parts, run.scene, newest, rates=rates_after(run.recoveries))
    try:
        for done in trainer.run():
            if done.number == last:
                return replace(newest, iteration=last, tensors=trainer.state())
    except ExplainedError as error:
        _log.warning("iteration %d failed already: %s", trainer.iteration + 1, error.what)
    return newest
