"""A whole run: load, initialize, train, evaluate, export; and its continuation after a stop."""

from __future__ import annotations

import errno
import logging
import math
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from time import monotonic

import torch
from rich.console import Console

from ..calls.read_only_guard import are_checked, checked_plugins, of_scene
from ..calls.watchdog import WATCHDOG
from ..contract.checks.scene import check_maps, validate
from ..contract.scene import Scene
from ..discovery import Plugins
from ..errors import RunError
from ..pipeline.faults import faults, refuse_missing_priors
from ..pipeline.parts import Parts, load_scene
from ..pipeline.pipeline import Pipeline
from ..pipeline.repeats import answer_of
from ..pipeline.training_settings import TrainingSettings
from ..system.interrupt import stop_on_interrupt
from ..toolkit.progress.display import showing
from ..toolkit.progress.stages import STAGES, progress
from ..training.assembly import assemble, restore
from ..training.checkpoint import CHECKPOINT, Checkpoint, explain_misfit
from ..training.initial_model import initial_gaussians
from ..training.trainer import Iteration, Trainer, one_torch_thread
from .evaluation import evaluate, quick
from .folder import RunFolder
from .opening import keep_failure, open_run
from .options import InitialState, RunOptions, find_device
from .origin import circumstances, refuse_changed_plugins
from .progress import EVERY, MetricsLog, Observers, TrainingProgress, observed
from .run import SUMS, Run, Stages
from .scene_facts import summary, warnings

AUTOSAVE_SECONDS = 30.0
"""Longest age of the newest checkpoint, whatever the pipeline's `checkpoint_every`."""
AUTOSAVE_SHARE = 0.005
"""Largest share of the time that saving by the clock may take; slow saving raises the age."""

QUICK = 0.1
"""Longest initialization that is repeated if plugins are not checked, in seconds."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""Disk errors; writing raises them without a file name."""

_NOT_RESUMED = ("scene", "initializer", "exporters", "reports", "observers")
"""Sections whose packages may change before a run is resumed; digests of the inputs cover the scene."""

_log = logging.getLogger(__name__)

ChooseFolder = Callable[[Pipeline, Scene], Path]
"""Returns the run folder once the scene is loaded."""


def in_runs(pipeline: Pipeline, scene: Scene) -> Path:
    """Return `runs/<pipeline>-<scene>`, or with "-2", "-3", ... if that exists.

    Characters that are unsafe in a file name become "-".
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", f"{pipeline.name}-{scene.name}").strip("-.") or "run"
    names = chain([plain], (f"{plain}-{number}" for number in count(2)))
    return next(path for name in names if not (path := Path("runs", name)).exists())


def start(pipeline: Pipeline, options: RunOptions, out: Path | ChooseFolder | None = None) -> Run:
    """Train a pipeline. Nothing is written before the scene, the points and the Gaussians are valid.

    Args:
        out: the run folder, or a function that returns one in `runs`; None writes nothing.

    Returns:
        The run. It is not `finished`, but has a checkpoint, if Ctrl-C or the callback stopped it.

    Raises:
        ExplainedError: any failure.
    """
    if out is not None:
        RunFolder.check_vacant(out if isinstance(out, Path) else Path("runs", "*"))
    refuse_missing_priors(pipeline)
    console = options.console()
    with _guarded(options, console):
        initial, seconds = _initialized(pipeline, options, console)
        while True:
            run, trainer = _new_run(initial, seconds)
            if out is not None:
                out = out if isinstance(out, Path) else out(run.pipeline, run.scene)
                run.keep_in(out)
            STAGES.begin(None)
            writing = f"; writing {out}" if out is not None else ""
            console.print(f"{len(initial.points):,} points; {initial.device.name}{writing}")
            with run.folder.locked() if run.folder else nullcontext():
                corrected = _train_to_end(run, trainer, options, resumed=False)
            if corrected is None:
                return run
            initial = initial.of(corrected)
            if run.folder is not None:
                shutil.rmtree(run.folder.path)


def resume(path: Path, options: RunOptions, plugins: Plugins) -> Run:
    """Continue a run from its checkpoint, to the same end as if it had never stopped.

    Raises:
        ExplainedError: the folder is not a run, has no checkpoint or is used by another process, or any later
            failure.
    """
    folder, console = RunFolder.existing(path), options.console()
    with _guarded(options, console), folder.locked():
        device = find_device(options.device)
        run = open_run(
            path,
            plugins=plugins,
            device=device,
            scene=options.scene,
            accept_changed_inputs=options.accept_changed_inputs,
        )
        refuse_missing_priors(run.pipeline)
        used = [item for item in run.pipeline if item.point.section not in _NOT_RESUMED]
        accept = options.accept_changed_plugins
        refuse_changed_plugins(folder.plugins, used, path, accept=accept)
        checkpoint = run.checkpoint()
        with explain_misfit(path / CHECKPOINT):
            trainer = restore(run.parts, run.scene, checkpoint)
        run.model = trainer.model
        run.record_changes()
        run.checkpoint = lambda: _checkpoint(run, trainer)
        folder.forget_metrics_after(checkpoint.iteration)
        folder.note_resumption(
            {"after": checkpoint.iteration, **circumstances(run.pipeline, run.model.engine)}
        )
        console.print(
            f"continuing after iteration {checkpoint.iteration} of "
            f"{run.pipeline.training.iterations}"
        )
        _train_to_end(run, trainer, options, resumed=True)
    return run


@contextmanager
def _guarded(options: RunOptions, console: Console) -> Iterator[None]:
    """One torch thread, progress on the console, and the checks of plugins that the options select."""
    with (
        one_torch_thread(),
        showing(console),
        checked_plugins(options.check_plugins),
        WATCHDOG.ending(options.hang_after),
    ):
        yield


def _initialized(
    pipeline: Pipeline, options: RunOptions, console: Console
) -> tuple[InitialState, Stages]:
    """Load the scene, create the first Gaussians, and choose the pipeline that trains them."""
    device = find_device(options.device)
    begin = monotonic()
    parts = Parts(pipeline, device)
    list(parts)  # constructs every component: find mistakes before the scene is loaded
    scene = load_scene(parts.one("scene")) if options.scene is None else validate(options.scene)
    resized = options.fit.resized(pipeline, scene)
    if resized is not pipeline:
        pipeline, parts = resized, parts.following(resized)
        scene = load_scene(parts.one("scene"))
    pipeline = pipeline.for_views(len(scene.train))
    parts = parts.following(pipeline)
    STAGES.begin(None)
    console.print(summary(scene))
    fallbacks = [
        f"fallback: the prior {i.fallback}" for i in pipeline.items["priors"] if i.fallback
    ]
    for warning in [*warnings(scene), *fallbacks, *faults(pipeline)]:
        console.print(f"warning: {warning}")
    had_scene = monotonic()
    initializer, known = parts.one("initializer"), scene.for_training()
    progress("depth" if initializer.component.needs_priors else "points")
    with initializer.at_work(lent=of_scene(known)):
        longest, given = math.inf if are_checked() else QUICK, (known, parts.priors)
        points = answer_of(initializer.component, "initialize", given, twice=True, longest=longest)
        check_maps(points.maps, known)
        gaussians = initial_gaussians(points, pipeline.training)
    seconds = Stages(had_scene - begin, monotonic() - had_scene)
    initial = InitialState(pipeline, parts, scene, points, gaussians, device)
    fitted = options.fit.fitted(initial)
    if fitted is not pipeline:
        refuse_missing_priors(fitted)
        initial = initial.of(fitted)
    return initial, seconds


def _new_run(initial: InitialState, seconds: Stages) -> tuple[Run, Trainer]:
    """Return a run before its first iteration, with its trainer."""
    pipeline, parts, points = initial.pipeline, initial.parts, initial.points
    trainer = assemble(parts, initial.scene, points, initial.gaussians)
    fallbacks = [item.fallback for item in pipeline.items["priors"] if item.fallback]
    facts = {
        "initializer": parts.one("initializer").item.name,
        "points": len(points),
        "seconds": round(seconds.initialization, 3),
        **({"fallbacks": fallbacks} if fallbacks else {}),
    }
    run = Run(
        pipeline,
        parts,
        initial.scene,
        trainer.model,
        checkpoint=lambda: _checkpoint(run, trainer),
        initialization={**facts, **points.facts, **facts},  # the host's values, in front
        pictures=dict(points.pictures),
        seconds=replace(seconds),
    )
    return run, trainer


def _train_to_end(
    run: Run, trainer: Trainer, options: RunOptions, *, resumed: bool
) -> Pipeline | None:
    """Train, report progress, and write the results after the last iteration.

    Returns the pipeline to start training again with if the plan corrects itself.
    """
    settings, metrics = run.pipeline.training, MetricsLog(run.add_metrics, run.sums)
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
                    break
                if corrected := options.fit.corrected(run):
                    return corrected
                longest = max(AUTOSAVE_SECONDS, saving_took / AUTOSAVE_SHARE)
                if _due(done.number, settings.checkpoint_every) or monotonic() - saved > longest:
                    begin = monotonic()
                    run.save_checkpoint()
                    saved = monotonic()
                    saving_took = saved - begin
                begin = monotonic()
            run.save_checkpoint()
        if run.finished and run.folder is not None:
            run.finish()
            observers.evaluated(run.scores)
    return None


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
    scores = evaluate(run.model, run.scene, run.scene.test, quick(run.parts["metrics"]))
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


def _checkpoint(run: Run, trainer: Trainer) -> Checkpoint:
    with _failures_kept(run, trainer):
        state = trainer.state()
    for name, pair in run.sums.items():
        state[f"{SUMS}/{name}"] = torch.tensor(pair, dtype=torch.float64)
    return Checkpoint(
        trainer.iteration, run.seconds.training, state, run.pipeline_text, run.identity
    )


def _evaluation_interval(settings: TrainingSettings) -> int:
    """Return iterations between two evaluations, by default a quarter of the run; 0: none."""
    if settings.evaluate_every is not None:
        return settings.evaluate_every
    quarter = settings.iterations // 4
    return quarter if quarter >= EVERY else 0


def _due(iteration: int, every: int) -> bool:
    return every > 0 and iteration % every == 0
