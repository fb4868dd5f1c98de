"""Iterations that failed: their checkpoints are kept, and `stereogs replay` repeats them.

RUN/failures/iteration-0000021/ is the checkpoint before iteration 21, with the error of that iteration. It is
created after the failure: training is repeated from the newest checkpoint up to the iteration before.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from core_rasterizer import Device, ExplainedError, Gaussians

from ..contract.scene import Scene
from ..errors import RunError
from ..inspection.scene_source import load
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, load_pipeline
from ..plugins.discovery import Plugins
from ..training.checkpoint import (
    CHECKPOINT,
    Checkpoint,
    explain_misfit,
    load_checkpoint,
    read_checkpoint,
    write_checkpoint,
)
from ..training.initial_model import new_model
from ..training.trainer import Trainer, resumed
from .folder import PIPELINE
from .origin import changed_inputs, input_digests, refuse_changed
from .run import Run

FAILURES = "failures"
_FIX = f"give a folder in RUN/{FAILURES}; `stereogs resume RUN` continues a run"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Failure:
    """An iteration that failed before and succeeds now.

    Args:
        iteration: its number.
        what: message of the earlier error.
    """

    iteration: int
    what: str


def keep_failure(run: Run, iteration: int, error: Exception) -> None:
    """Keep the checkpoint before a failed iteration, and add to the error how to repeat the iteration.

    If training cannot be repeated up to there, keep the newest checkpoint. Without a run folder, do nothing.

    Args:
        iteration: the failed iteration.
        error: its exception; an `ExplainedError` gets the replay command in its `fix`.
    """
    if run.folder is None:
        return
    try:
        before = _checkpoint_before(run, iteration)
        notes = {
            "iteration": iteration,
            "what": error.what if isinstance(error, ExplainedError) else repr(error),
            "inputs": input_digests(run.scene, run.pipeline),
        }
        place = run.folder.folder(FAILURES) / f"iteration-{iteration:07d}"
        shutil.rmtree(place, ignore_errors=True)  # the same iteration, failed before
        write_checkpoint(replace(before, notes=notes), place)
    except Exception as second:  # the first error is reported, whatever this one is
        _log.warning("the checkpoint before the failure could not be kept: %s", second)
        return
    if isinstance(error, ExplainedError):
        error.fix += f"{'; ' if error.fix else ''}`stereogs replay {place}` repeats the iteration"


def _checkpoint_before(run: Run, iteration: int) -> Checkpoint:
    """Return the checkpoint before an iteration, or the nearest one that repeated training reaches."""
    newest = load_checkpoint(run.folder_or_refuse().path / CHECKPOINT)
    if newest.iteration == iteration - 1:
        return newest
    _log.info(
        "repeating from iteration %d to keep the checkpoint before the failure",
        newest.iteration + 1,
    )
    device = run.model.device
    trainer = _trainer(newest, run.pipeline, Parts(run.pipeline, device), run.scene, device)
    try:
        for done in trainer.run():
            if done.number == iteration - 1:
                return replace(newest, iteration=done.number, tensors=trainer.state())
    except ExplainedError as error:
        _log.warning("iteration %d failed already: %s", trainer.iteration + 1, error.what)
    return newest


def replay(
    place: Path,
    *,
    plugins: Plugins,
    device: Device,
    accept_changed_inputs: bool = False,
) -> Failure:
    """Repeat an iteration that failed.

    Args:
        place: the folder that `keep_failure` wrote, or a file in it.
        accept_changed_inputs: continue even if photographs, cameras or model files have changed.

    Returns:
        The earlier failure, if the iteration succeeds now.

    Raises:
        ExplainedError: the iteration fails again; or the place does not hold a failed iteration.
    """
    if place.is_file():
        place = place.parent
    if not place.is_dir():
        raise RunError("there is no such folder", where=str(place), fix=_FIX)
    checkpoint = read_checkpoint(place)
    pipeline = load_pipeline(place / PIPELINE, plugins)
    iteration, what, inputs = _noted(checkpoint, pipeline, place)
    parts = Parts(pipeline, device)
    scene = load(parts.one("scene"))
    changed = changed_inputs(inputs, input_digests(scene, pipeline))
    if not accept_changed_inputs:
        refuse_changed(changed, place)
    with explain_misfit(place):
        trainer = _trainer(checkpoint, pipeline, parts, scene, device)
    for done in trainer.run():
        if done.number == iteration:
            break
    return Failure(iteration, what)


def _trainer(
    checkpoint: Checkpoint, pipeline: Pipeline, parts: Parts, scene: Scene, device: Device
) -> Trainer:
    """Return a new trainer that continues after a checkpoint."""
    model = new_model(Gaussians(**checkpoint.part("model")), pipeline.training, device)
    return resumed(checkpoint, pipeline.training, parts, scene, model)


def _noted(
    checkpoint: Checkpoint, pipeline: Pipeline, place: Path
) -> tuple[int, str, dict[str, str]]:
    """Return the iteration, its error, and the digests of the inputs."""
    notes = checkpoint.notes
    iteration, inputs = notes.get("iteration"), notes.get("inputs")
    if type(iteration) is not int or not isinstance(inputs, dict):
        raise RunError(
            "this is the checkpoint of a run, not of a failed iteration",
            where=str(place),
            fix=_FIX,
        )
    if not checkpoint.iteration < iteration <= pipeline.training.iterations:
        raise RunError(
            f"iteration {iteration} does not come after {checkpoint.iteration} in a run of "
            f"{pipeline.training.iterations}",
            where=str(place),
            fix=_FIX,
        )
    return iteration, str(notes.get("what")), inputs
