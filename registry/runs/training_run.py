"""A whole run: load, initialize, train, evaluate, export; and its continuation after a stop."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import monotonic

from rich.console import Console

from core_rasterizer import Device, ExplainedError

from ..calls.read_only_guard import checked_plugins, of_scene
from ..calls.watchdog import WATCHDOG
from ..contract.checks.scene import validate
from ..contract.scene import Scene
from ..inspection.prior_needs import refuse_missing_priors
from ..inspection.scene_facts import summary, warnings
from ..inspection.scene_source import load
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline
from ..pipeline.training_settings import TrainingSettings
from ..plugins.discovery import Plugins
from ..system.interrupt import stop_on_interrupt
from ..training.checkpoint import CHECKPOINT, Checkpoint, explain_misfit
from ..training.initial_model import initial_gaussians, new_model
from ..training.threads import one_torch_thread
from ..training.trainer import Iteration, Trainer, resumed
from .evaluation import evaluate, quick
from .folder import RunFolder, default_folder
from .observers import observed
from .opening import open_run
from .options import InitialState, RunOptions, find_device
from .origin import circumstances
from .progress import EVERY, MetricsLog, TrainingProgress
from .replay import keep_failure
from .run import Run, Stages

AUTOSAVE_SECONDS = 30.0
"""Longest age of the newest checkpoint, whatever the pipeline's `checkpoint_every`."""
AUTOSAVE_SHARE = 0.005
"""Largest share of the time that saving by the clock may take; slow saving raises the age."""

_log = logging.getLogger(__name__)

ChooseFolder = Callable[[Pipeline, Scene], Path]
"""Returns the run folder once the scene is loaded."""


def in_runs(pipeline: Pipeline, scene: Scene) -> Path:
    """Return `runs/<pipeline>-<scene>`, numbered if that exists."""
    return default_folder(f"{pipeline.name}-{scene.name}")


def start(pipeline: Pipeline, options: RunOptions, out: Path | ChooseFolder | None = None) -> Run:
    """Train a pipeline.

    Nothing is written before the scene, the points and the Gaussians are valid.

    Args:
        options: `scene` replaces the scene that the pipeline loads.
        out: the run folder, or a function that returns it; None writes nothing.

    Returns:
        The run. It is not `finished`, but has a checkpoint, if Ctrl-C or the callback stopped it.

    Raises:
        ExplainedError: any failure.
    """
    if isinstance(out, Path):
        RunFolder.check_vacant(out)
    refuse_missing_priors(pipeline)
    console = options.console()
    with _guarded(options):
        run, trainer = _initialized(pipeline, options, console)
        if out is not None:
            run.keep_in(out if isinstance(out, Path) else out(run.pipeline, run.scene))
        writing = f"; writing {run.folder.path}" if run.folder else ""
        console.print(f"{run.initialization['points']:,} points; {run.model.device.name}{writing}")
        with run.folder.locked() if run.folder else nullcontext():
            _train_to_end(run, trainer, options, console, resumed=False)
    return run


def resume(path: Path, options: RunOptions, plugins: Plugins) -> Run:
    """Continue a run from its checkpoint, to the same end as if it had never stopped.

    Raises:
        ExplainedError: the folder is not a run, has no checkpoint or is used by another process, or any later
            failure.
    """
    folder, console = RunFolder.existing(path), options.console()
    with _guarded(options), folder.locked():
        device = find_device(options.device)
        run = open_run(
            path,
            plugins=plugins,
            device=device,
            scene=options.scene,
            accept_changed_inputs=options.accept_changed_inputs,
        )
        refuse_missing_priors(run.pipeline)
        checkpoint = run.checkpoint()
        with explain_misfit(path / CHECKPOINT):
            trainer = resumed(checkpoint, run.pipeline.training, run.parts, run.scene, run.model)
        run.record_changes()
        run.checkpoint = lambda: _checkpoint(run, trainer)
        folder.forget_metrics_after(checkpoint.iteration)
        folder.note_resumption(
            {"after": checkpoint.iteration, **circumstances(run.pipeline, device)}
        )
        console.print(
            f"continuing after iteration {checkpoint.iteration} of "
            f"{run.pipeline.training.iterations}"
        )
        _train_to_end(run, trainer, options, console, resumed=True)
    return run


@contextmanager
def _guarded(options: RunOptions) -> Iterator[None]:
    """One torch thread, and the checks of plugins that the options select."""
    with (
        one_torch_thread(),
        checked_plugins(options.check_plugins),
        WATCHDOG.ending(options.hang_after),
    ):
        yield


def _initialized(pipeline: Pipeline, options: RunOptions, console: Console) -> tuple[Run, Trainer]:
    """Load the scene, create the first Gaussians, and return the run with its trainer."""
    device: Device = find_device(options.device)
    begin = monotonic()
    parts = Parts(pipeline, device)
    list(parts)  # constructs every component: find mistakes before the scene is loaded
    scene = load(parts.one("scene")) if options.scene is None else validate(options.scene)
    pipeline = pipeline.for_views(len(scene.train))
    parts = parts.following(pipeline)
    console.print(summary(scene))
    for warning in warnings(scene):
        console.print(f"warning: {warning}")
    had_scene = monotonic()
    initializer = parts.one("initializer")
    known = scene.for_training()
    with initializer.at_work(lent=of_scene(known)):
        points = initializer.component.initialize(known, parts.priors)
        gaussians = initial_gaussians(points, pipeline.training)
    seconds = Stages(had_scene - begin, monotonic() - had_scene)
    if options.fit is not None:
        first = InitialState(pipeline, parts, scene, points, gaussians, device)
        pipeline = options.fit(first)
        refuse_missing_priors(pipeline)
        parts = parts.following(pipeline)
        gaussians = initial_gaussians(points, pipeline.training)
    model = new_model(gaussians, pipeline.training, device)
    facts = {
        "initializer": initializer.item.name,
        "points": len(points),
        "seconds": round(seconds.initialization, 3),
    }
    facts |= {name: value for name, value in points.facts.items() if name not in facts}
    trainer = Trainer(pipeline.training, parts, scene, model, points.maps, points.kinds)
    run = Run(
        pipeline,
        parts,
        scene,
        model,
        checkpoint=lambda: _checkpoint(run, trainer),
        initialization=facts,
        pictures=dict(points.pictures),
        seconds=seconds,
    )
    return run, trainer


def _train_to_end(
    run: Run, trainer: Trainer, options: RunOptions, console: Console, *, resumed: bool
) -> None:
    """Train, report progress, and write the results if the last iteration is complete."""
    with observed(run, trainer, resumed=resumed) as observers:
        if options.on_begin is not None:
            options.on_begin(run)
        settings = run.pipeline.training
        metrics, autosave = MetricsLog(run.add_metrics), _Autosave(run)
        with (
            stop_on_interrupt() as stop,
            TrainingProgress(trainer.iteration, settings.iterations, console) as progress,
        ):
            begin = monotonic()
            for done in _iterations(run, trainer):
                run.seconds.training += monotonic() - begin
                run.iteration = done.number
                progress.update(done.number, done.loss, done.gaussians)
                metrics.add(done, run.seconds.training, last=done.number == settings.iterations)
                observers.iterated(done)
                # A finished run is always scored, with pictures.
                if not run.finished and _due(done.number, _evaluation_interval(settings)):
                    metrics_now = quick(run.parts["metrics"])
                    scores = evaluate(run.model, run.scene, run.scene.test, metrics_now)
                    at = {"iteration": done.number, "seconds": round(run.seconds.training, 3)}
                    metrics.write({**at, "test": scores.mean})
                    observers.evaluated({"test": scores})
                    for error in scores.failures.values():
                        _log.warning("iteration %d: %s (%s)", done.number, error.what, error.where)
                stopped = options.callback is not None and options.callback(done) is False
                if stop.requested or stopped:
                    break
                if _due(done.number, settings.checkpoint_every) or autosave.due():
                    autosave.save()
                begin = monotonic()
            run.save_checkpoint()
        if run.finished and run.folder is not None:
            run.finish()
            observers.evaluated(run.scores)


class _Autosave:
    """Checkpoints by the clock, so that a run that is killed loses little."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._last, self._cost = monotonic(), 0.0

    def due(self) -> bool:
        """Return whether the newest checkpoint is old."""
        return monotonic() - self._last > max(AUTOSAVE_SECONDS, self._cost / AUTOSAVE_SHARE)

    def save(self) -> None:
        """Save a checkpoint."""
        begin = monotonic()
        self._run.save_checkpoint()
        self._last = monotonic()
        self._cost = self._last - begin


def _iterations(run: Run, trainer: Trainer) -> Iterator[Iteration]:
    """Train; if an iteration fails, keep what is needed to repeat it."""
    try:
        yield from trainer.run()
    except Exception as error:
        keep_failure(run, trainer.iteration + 1, error)
        raise


def _checkpoint(run: Run, trainer: Trainer) -> Checkpoint:
    """Return a checkpoint; if the state cannot be saved, keep it as a failure of the next iteration."""
    try:
        state = trainer.state()
    except ExplainedError as error:
        keep_failure(run, trainer.iteration + 1, error)
        raise
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
