"""A whole run: load, initialize, train, evaluate, export; and its continuation after a stop."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from time import monotonic

import torch

from core_rasterizer import GaussianError

from ..discovery import Plugins
from ..errors import RunError
from ..pipeline.faults import refuse_unmet_needs
from ..pipeline.pipeline import Pipeline
from ..pipeline.training_settings import TrainingSettings
from ..system.interrupt import stop_on_interrupt
from ..toolkit.progress.stages import STAGES
from ..training.assembly import assemble, restore
from ..training.checkpoint import (
    CHECKPOINT,
    EDITS,
    RECOVERIES,
    Checkpoint,
    explain_misfit,
    load_checkpoint,
    rates_after,
)
from ..training.trainer import Iteration, Trainer
from .evaluation import evaluate, quick
from .folder import ChooseFolder, RunFolder, refuse_occupied
from .opening import keep_failure, load_run
from .options import RunOptions, find_device
from .origin import circumstances, refuse_changed_plugins
from .outputs import finish, record_changed_inputs
from .preparation import Prepared, load, prepare, running
from .progress import EVERY, SUMS, MetricsLog, Observers, TrainingProgress, observed
from .run import Run
from .trained_scene import Stages

AUTOSAVE_SECONDS = 30.0
"""Longest age of the newest checkpoint, whatever the pipeline's `checkpoint_every`."""
AUTOSAVE_SHARE = 0.005
"""Largest share of the time that saving by the clock may take; slow saving raises the age."""

MOST_RECOVERIES = 5
"""Number of returns to a checkpoint (`RunOptions.recover`) after which the error ends the run."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""Disk errors; writing raises them without a file name."""

_NOT_RESUMED = ("scene", "initializer", "exporters", "reports", "observers")
"""Sections whose packages may change before a run is resumed; digests of the inputs cover the scene."""

_log = logging.getLogger(__name__)


def start_run(
    pipeline: Pipeline, options: RunOptions, out: Path | ChooseFolder | None = None
) -> Run:
    """Train a pipeline. Nothing is written before the scene, the points and the Gaussians are valid.

    Args:
        out: the run folder, or a function that returns one in `runs`; None writes nothing.

    Returns:
        The run. It is not `finished`, but has a checkpoint, if Ctrl-C or the callback stopped it.

    Raises:
        ExplainedError: any failure.
    """
    refuse_occupied(out)
    with running(options) as active:
        return train_prepared(prepare(load(pipeline, active), active), active, out)


def train_prepared(
    initial: Prepared, options: RunOptions, out: Path | ChooseFolder | None = None
) -> Run:
    """Train from the first iteration, within `running`; arguments and errors as for `start_run`."""
    run, trainer, metrics = _new_run(initial)
    writing = ""
    if out is not None:
        _keep(run, out)
        writing = f"; writing {run.folder_or_refuse().shown()}"
    STAGES.begin(None)
    device = initial.parts.device.name
    options.console().print(f"{len(initial.points):,} points; {device}{writing}")
    with run.folder.training() if run.folder else nullcontext():
        _train_or_recover(run, trainer, metrics, options, resumed=False)
    return run


def _keep(run: Run, out: Path | ChooseFolder) -> None:
    """Create the run folder."""
    folder = out if isinstance(out, Path) else out(run.pipeline, run.scene)
    while True:
        try:
            return run.keep_in(folder)
        except RunError:
            if isinstance(out, Path) or (other := out(run.pipeline, run.scene)) == folder:
                raise
            folder = other  # another training took the name meanwhile


def continue_run(path: Path, options: RunOptions, plugins: Plugins) -> Run:
    """Continue a run from its checkpoint, to the same end as if it had never stopped.

    Raises:
        ExplainedError: the folder is not a run, has no checkpoint or is used by another process, or any later
            failure.
    """
    folder = RunFolder.existing(path)
    with running(options) as active, folder.training():
        device = find_device(options.device)
        run = load_run(
            path,
            plugins=plugins,
            device=device,
            scene=options.scene or options.scene_folder,
            accept_changed_inputs=options.accept_changed_inputs,
        )
        absolute = run.engine_model.engine.absolute_gradients
        refuse_unmet_needs(run.pipeline, absolute_gradients=absolute)
        used = [item for item in run.pipeline if item.point.section not in _NOT_RESUMED]
        accept = options.accept_changed_plugins
        refuse_changed_plugins(folder.plugins, used, path, accept=accept)
        checkpoint = run.checkpoint()
        with explain_misfit(path / CHECKPOINT):
            rates = rates_after(run.recoveries)
            trainer = restore(run.parts, run.scene, checkpoint, run.engine_model, rates)
        record_changed_inputs(run, folder)
        metrics = _metrics_after(checkpoint, run)
        run.checkpoint = lambda: _checkpoint(run, trainer, metrics)
        folder.note_resumption(
            {"after": checkpoint.iteration, **circumstances(run.pipeline, run.engine_model.engine)}
        )
        active.console().print(
            f"continuing after iteration {checkpoint.iteration} of "
            f"{run.pipeline.training.iterations}"
        )
        _train_or_recover(run, trainer, metrics, active, resumed=True)
    return run


def _metrics_after(checkpoint: Checkpoint, run: Run) -> MetricsLog:
    """Remove the metrics after a checkpoint, and return the log that continues there."""
    if run.folder is not None:
        run.folder.forget_metrics_after(checkpoint.iteration)
    run.metrics[:] = [line for line in run.metrics if line["iteration"] <= checkpoint.iteration]
    sums = {name: (float(s[0]), int(s[1])) for name, s in checkpoint.part(SUMS).items()}
    return MetricsLog(run.add_metrics, sums)


def _new_run(initial: Prepared) -> tuple[Run, Trainer, MetricsLog]:
    """Return a run before its first iteration, with its trainer and the log of its metrics."""
    pipeline, points = initial.pipeline, initial.points
    trainer = assemble(initial.parts, initial.framed, points, initial.gaussians)
    fallbacks = [item.fallback for item in pipeline.items["priors"] if item.fallback]
    facts = {
        "initializer": pipeline.one("initializer").name,
        "points": len(points),
        "seconds": round(initial.initialization, 3),
        **({"fallbacks": fallbacks} if fallbacks else {}),
    }
    run = Run(
        pipeline,
        initial.parts,
        initial.scene,
        trainer.model,
        initial.framed.frame,
        checkpoint=lambda: _checkpoint(run, trainer, metrics),
        initialization={
            **facts,
            **points.facts,
            **facts,
        },  # host's names first, with its values
        pictures=dict(points.pictures),
        seconds=Stages(initial.loading, initial.initialization),
    )
    metrics = MetricsLog(run.add_metrics, {})
    return run, trainer, metrics


def _train_or_recover(
    run: Run, trainer: Trainer, metrics: MetricsLog, options: RunOptions, *, resumed: bool
) -> None:
    """`_train_to_end`; on a parameter that is not finite go back to the checkpoint if options say so."""
    while True:
        try:
            return _train_to_end(run, trainer, metrics, options, resumed=resumed)
        except GaussianError as error:
            most = len(run.recoveries) == MOST_RECOVERIES
            if not options.recover or run.folder is None or most:
                raise
            checkpoint = load_checkpoint(run.folder.path / CHECKPOINT)
            rates = rates_after([*run.recoveries, error])
            found = {"iteration": trainer.iteration + 1, "back_to": checkpoint.iteration}
            run.recoveries.append({**found, "rates": rates, "error": str(error.what)})
            _log.warning(
                "iteration %d: %s; continuing after iteration %d with learning rates times %g",
                *(trainer.iteration + 1, error.what, checkpoint.iteration, rates),
            )
        run.parts = run.parts.following(run.pipeline)
        trainer = restore(run.parts, run.scene, checkpoint, rates=rates)
        metrics, resumed = _metrics_after(checkpoint, run), True
        run.engine_model, run.iteration = trainer.model, checkpoint.iteration
        run.saved_iteration = checkpoint.iteration
        run.checkpoint = partial(_checkpoint, run, trainer, metrics)


def _train_to_end(
    run: Run, trainer: Trainer, metrics: MetricsLog, options: RunOptions, *, resumed: bool
) -> None:
    """Train, report progress, and write the results after the last iteration."""
    settings = run.pipeline.training
    with _explaining_how_to_continue(run), observed(run, trainer, resumed=resumed) as observers:
        if options.on_begin is not None:
            options.on_begin(run)
        shown = TrainingProgress(trainer.iteration, settings.iterations)
        with stop_on_interrupt() as stop, STAGES.fixed(shown.stage):
            saved, saving_took = monotonic(), 0.0
            begin = monotonic()
            for done in _iterations(run, trainer):
                run.seconds.training += monotonic() - begin
                run.iteration = done.number
                shown.update(done)
                metrics.add(done, run.seconds.training, last=done.number == settings.iterations)
                observers.iterated(done)
                # A finished run is always scored, with pictures.
                if not run.finished and _due(done.number, _evaluation_interval(settings)):
                    _score_test_views(run, metrics, observers)
                stopped = options.callback is not None and options.callback(done) is False
                if stop.requested or stopped:
                    run.interrupted = stop.requested
                    break
                longest = max(AUTOSAVE_SECONDS, saving_took / AUTOSAVE_SHARE)
                if _due(done.number, settings.checkpoint_every) or monotonic() - saved > longest:
                    begin = monotonic()
                    run.save_checkpoint()
                    saved = monotonic()
                    saving_took = saved - begin
                begin = monotonic()
            run.save_checkpoint()
        if run.finished and run.folder is not None:
            finish(run, run.folder)
            observers.evaluated(run.scores)


@contextmanager
def _explaining_how_to_continue(run: Run) -> Iterator[None]:
    """Add the command that continues the run to Ctrl-C, and to errors of its disk."""
    if run.folder is None:
        yield
        return
    path = run.folder.path
    try:
        yield
        run.check_folder()
    except KeyboardInterrupt as stop:
        kept = "trained scene" if run.finished else "last checkpoint"
        rest = "scores it and writes its page" if run.finished else "continues from it"
        stop.add_note(f"\n  The {kept} is kept. `stereogs resume {path}` {rest}")
        raise
    except RunError:
        run.check_folder()
        raise
    except OSError as error:
        run.check_folder()
        file = Path(str(error.filename)).resolve()
        if error.errno not in _FULL and path.resolve() not in file.parents:
            raise  # not about a file of the run: raised by a callback
        raise RunError(
            f"a file of the run cannot be written: {error.strerror or error}",
            where=str(path),
            fix=f"free some disk space, or check the permissions; then `stereogs resume {path}`",
        ) from error


def _score_test_views(run: Run, metrics: MetricsLog, observers: Observers) -> None:
    scores = evaluate(run.engine_model, run.framed, run.framed.test, quick(run.parts["metrics"]))
    at = {"iteration": run.iteration, "seconds": round(run.seconds.training, 3)}
    metrics.write({**at, "test": scores.mean})
    observers.evaluated({"test": scores})
    for error in scores.failures.values():
        _log.warning("iteration %d: %s (%s)", run.iteration, error.what, error.where)


@contextmanager
def _failures_kept(run: Run, trainer: Trainer) -> Iterator[None]:
    """If the block fails, keep what is needed to repeat the next iteration."""
    try:
        yield
    except Exception as error:
        keep_failure(run, trainer.iteration + 1, error)
        raise


def _iterations(run: Run, trainer: Trainer) -> Iterator[Iteration]:
    with _failures_kept(run, trainer):
        yield from trainer.run()


def _checkpoint(run: Run, trainer: Trainer, metrics: MetricsLog) -> Checkpoint:
    with _failures_kept(run, trainer):
        state = trainer.state()
    for name, pair in metrics.sums.items():
        state[f"{SUMS}/{name}"] = torch.tensor(pair, dtype=torch.float64)
    notes = {k: v for k, v in ((RECOVERIES, run.recoveries), (EDITS, run.edits)) if v}
    return Checkpoint(
        trainer.iteration, run.seconds.training, state, run.pipeline_text, run.identity, notes
    )


def _evaluation_interval(settings: TrainingSettings) -> int:
    """Return iterations between two evaluations, by default a quarter of the run; 0: none."""
    if settings.evaluate_every is not None:
        return settings.evaluate_every
    quarter = settings.iterations // 4
    return quarter if quarter >= EVERY else 0


def _due(iteration: int, every: int) -> bool:
    return every > 0 and iteration % every == 0
