"""A whole run: load, initialize, train, evaluate, export. And going on with one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from time import monotonic

from rich.console import Console

from core_rasterizer import Device, ExplainedError

from ..calls.read_only_guard import of_scene
from ..contract.scene import Scene
from ..inspection.scene_facts import summary, warnings
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline
from ..pipeline.training_settings import TrainingSettings
from ..plugins.discovery import Plugins
from ..training.checkpoint import CHECKPOINT, Checkpoint, explain_misfit
from ..training.initial_model import initial_gaussians, new_model
from ..training.trainer import Iteration, Trainer, resumed
from .autosave import Autosave
from .beginning import Beginning, Fit
from .evaluation import evaluate, quick
from .folder import RunFolder, default_folder
from .guarding.interrupt import stop_on_interrupt
from .observing.metrics_log import EVERY, MetricsLog
from .observing.observers import Observers, observed
from .observing.progress import TrainingProgress
from .opened import open_run
from .origin.inputs import load_scene
from .origin.provenance import circumstances
from .replay import keep_failure
from .results import finish
from .run import Run, Stages

_log = logging.getLogger(__name__)

Callback = Callable[[Iteration], bool | None]
"""What is told of each iteration; False stops training after it."""
OnBegin = Callable[[Run], None]
"""What is given the run before its next iteration; it may look at it and must not change it."""
ChooseFolder = Callable[[Pipeline, Scene], Path]
"""Names a run's folder once its scene is known."""


def in_runs(pipeline: Pipeline, scene: Scene) -> Path:
    """`runs/<pipeline>-<scene>`, numbered if that exists."""
    return default_folder(f"{pipeline.name}-{scene.name}")


def start(
    pipeline: Pipeline,
    *,
    device: Device,
    out: Path | ChooseFolder | None,
    console: Console,
    scene: Scene | None = None,
    on_begin: OnBegin | None = None,
    callback: Callback | None = None,
    fit: Fit | None = None,
) -> Run:
    """Train a pipeline.

    Nothing is written before the scene, the points and the Gaussians are there and valid.

    Args:
        out: the run folder, or what names it; None writes nothing at all.
        console: is told how it goes.
        scene: in place of what the pipeline's loader would load; valid.
        fit: chooses the pipeline that goes on from the first Gaussians; None: the same one.

    Returns:
        The run; not `finished` after Ctrl-C or at the callback's wish, with a checkpoint in its folder.

    Raises:
        ExplainedError: whatever went wrong.
    """
    if isinstance(out, Path):
        RunFolder.check_vacant(out)
    run, trainer = _begun(pipeline, scene, device, console, fit)
    if out is not None:
        run.keep_in(out if isinstance(out, Path) else out(run.pipeline, run.scene))
    writing = f"; writing {run.folder.path}" if run.folder else ""
    console.print(f"{run.initialization['points']:,} points; {device.name}{writing}")
    with (
        run.folder.to_itself() if run.folder else nullcontext(),
        observed(run, trainer, resumed=False) as observers,
    ):
        _train_to_end(run, trainer, observers, console, on_begin, callback)
    return run


def resume(
    path: Path,
    *,
    plugins: Plugins,
    device: Device,
    console: Console,
    scene: Scene | None = None,
    on_begin: OnBegin | None = None,
    callback: Callback | None = None,
    accept_changed_inputs: bool = False,
) -> Run:
    """Go on with a run from its checkpoint, to the same end as if it had never stopped.

    Args:
        accept_changed_inputs: go on with other photographs, cameras or model files than it began with.

    Raises:
        ExplainedError: the folder is no run, has no checkpoint, another process works on it, or
            whatever goes wrong later.
    """
    with RunFolder.existing(path).to_itself():
        run = open_run(
            path,
            plugins=plugins,
            device=device,
            scene=scene,
            accept_changed_inputs=accept_changed_inputs,
        )
        checkpoint = run.checkpoint()
        with explain_misfit(path / CHECKPOINT):
            trainer = resumed(checkpoint, run.pipeline.training, run.parts, run.scene, run.model)
        run.keep_changes()
        run.checkpoint = lambda: _checkpoint(run, trainer)
        folder = run.folder_or_refuse()
        folder.forget_metrics_after(checkpoint.iteration)
        folder.note_resumption(
            {"after": checkpoint.iteration, **circumstances(run.pipeline, device)}
        )
        console.print(
            f"going on after iteration {checkpoint.iteration} of {run.pipeline.training.iterations}"
        )
        with observed(run, trainer, resumed=True) as observers:
            _train_to_end(run, trainer, observers, console, on_begin, callback)
    return run


def _begun(
    pipeline: Pipeline, scene: Scene | None, device: Device, console: Console, fit: Fit | None
) -> tuple[Run, Trainer]:
    """The first Gaussians, and the trainer that is about to train them."""
    begin = monotonic()
    parts = Parts(pipeline, device)
    scene = scene or load_scene(parts)
    if pipeline.iterations_per_view is not None:
        pipeline = pipeline.for_views(len(scene.train))
        parts = Parts(pipeline, device)
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
    if fit is not None:
        pipeline = fit(Beginning(pipeline, scene, points, gaussians, device))
        gaussians = initial_gaussians(points, pipeline.training)
        parts = Parts(pipeline, device)
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
    run: Run,
    trainer: Trainer,
    observers: Observers,
    console: Console,
    on_begin: OnBegin | None,
    callback: Callback | None,
) -> None:
    """Train, tell of it, and write the results if the end was reached and there is a folder for them."""
    if on_begin is not None:
        on_begin(run)
    settings = run.pipeline.training
    metrics = MetricsLog(run.add_metrics)
    autosave = Autosave(run)
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
            # What is finished is scored in any case, with its pictures.
            if not run.finished and _due(done.number, _evaluation_interval(settings)):
                scores = evaluate(run.model, run.scene, run.scene.test, quick(run.parts["metrics"]))
                at = {"iteration": done.number, "seconds": round(run.seconds.training, 3)}
                metrics.write({**at, "test": scores.mean})
                observers.evaluated({"test": scores})
                for error in scores.failures.values():
                    _log.warning("iteration %d: %s (%s)", done.number, error.what, error.where)
            wanted = callback is None or callback(done) is not False
            if stop.requested or not wanted:
                break
            if _due(done.number, settings.checkpoint_every) or autosave.due():
                autosave.save()
            begin = monotonic()
        run.save_checkpoint()
    if run.finished and run.folder is not None:
        finish(run)
        observers.evaluated(run.scores)


def _iterations(run: Run, trainer: Trainer) -> Iterator[Iteration]:
    """Train; what is needed to repeat an iteration that fails is kept."""
    try:
        yield from trainer.run()
    except Exception as error:
        keep_failure(run, trainer.iteration + 1, error)
        raise


def _checkpoint(run: Run, trainer: Trainer) -> Checkpoint:
    """The moment between two iterations; one that cannot be saved is kept as a failure of the next."""
    try:
        state = trainer.state()
    except ExplainedError as error:
        keep_failure(run, trainer.iteration + 1, error)
        raise
    return Checkpoint(
        trainer.iteration, run.seconds.training, state, run.pipeline_text, run.identity
    )


def _evaluation_interval(settings: TrainingSettings) -> int:
    """Iterations between two evaluations: a quarter of the run, if that is worth a line of metrics."""
    if settings.evaluate_every is not None:
        return settings.evaluate_every
    quarter = settings.iterations // 4
    return quarter if quarter >= EVERY else 0


def _due(iteration: int, every: int) -> bool:
    return every > 0 and iteration % every == 0
