"""Iterations that failed: what is needed to repeat one is kept, and `stereogs replay` repeats it.

RUN/failures/iteration-0000021/ is a checkpoint of the moment before iteration 21, with its error beside it.
Nothing is prepared for that while all is well: after the failure, training is done again from the newest
checkpoint up to the iteration before.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from core_rasterizer import Device, ExplainedError, Gaussians

from ..contract.scene import Scene
from ..errors import RunError
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, load_pipeline
from ..plugins.discovery import Plugins
from ..training.checkpoint import (
    Checkpoint,
    explain_misfit,
    load_checkpoint,
    read_checkpoint,
    write_checkpoint,
)
from ..training.initial_model import new_model
from ..training.trainer import Trainer, resumed
from .folder import PIPELINE
from .origin.inputs import changed_inputs, input_digests, load_scene, refuse_changed
from .run import CHECKPOINT, Run

FAILURES = "failures"
_FIX = f"give a folder in RUN/{FAILURES}; a run goes on with `stereogs resume RUN`"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Failure:
    """An iteration that failed before, and goes through now.

    Args:
        iteration: its number.
        what: what was wrong then.
    """

    iteration: int
    what: str


def keep_failure(run: Run, iteration: int, error: Exception) -> None:
    """Keep the moment before an iteration that failed, and say in the error how to repeat it.

    Where training cannot be done again up to there, its newest checkpoint is kept in its place. A run
    without a folder keeps nothing.

    Args:
        iteration: the one that failed.
        error: what it raised; gains the replay in its `fix` if it is an `ExplainedError`.
    """
    if run.folder is None:
        return
    try:
        before = _moment_before(run, iteration)
        notes = {
            "iteration": iteration,
            "what": error.what if isinstance(error, ExplainedError) else repr(error),
            "inputs": input_digests(run.scene, run.pipeline),
        }
        place = run.folder.folder(FAILURES) / f"iteration-{iteration:07d}"
        shutil.rmtree(place, ignore_errors=True)  # the same iteration, failed before
        write_checkpoint(replace(before, notes=notes), place)
    except Exception as second:  # whatever it is, the first error is the one to be told
        _log.warning("the moment before the failure could not be kept: %s", second)
        return
    if isinstance(error, ExplainedError):
        error.fix += f"{'; ' if error.fix else ''}`stereogs replay {place}` repeats the iteration"


def _moment_before(run: Run, iteration: int) -> Checkpoint:
    """The checkpoint of the iteration before, or as near to it as training comes again."""
    newest = load_checkpoint(run.folder_or_refuse().path / CHECKPOINT)
    if newest.iteration == iteration - 1:
        return newest
    _log.info("repeating from iteration %d to keep the moment before", newest.iteration + 1)
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
        accept_changed_inputs: repeat it although photographs, cameras or model files have changed.

    Returns:
        The failure, which did not come again.

    Raises:
        ExplainedError: it fails again; or the place holds no such iteration, or it is damaged.
    """
    if place.is_file():
        place = place.parent
    if not place.is_dir():
        raise RunError("there is no such folder", where=str(place), fix=_FIX)
    checkpoint = read_checkpoint(place)
    pipeline = load_pipeline(place / PIPELINE, plugins)
    iteration, what, inputs = _noted(checkpoint, pipeline, place)
    parts = Parts(pipeline, device)
    scene = load_scene(parts)
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
    """A trainer of its own that goes on after a checkpoint."""
    model = new_model(Gaussians(**checkpoint.part("model")), pipeline.training, device)
    return resumed(checkpoint, pipeline.training, parts, scene, model)


def _noted(
    checkpoint: Checkpoint, pipeline: Pipeline, place: Path
) -> tuple[int, str, dict[str, str]]:
    """The iteration, its error, and the digests of the inputs."""
    notes = checkpoint.notes
    iteration, inputs = notes.get("iteration"), notes.get("inputs")
    if type(iteration) is not int or not isinstance(inputs, dict):
        raise RunError(
            "this is the checkpoint of a run, and no iteration that failed",
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
