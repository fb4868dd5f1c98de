"""A whole run: load, initialize, train with observers, evaluate, export. And going on with one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import monotonic

from rich.console import Console

from core_rasterizer import Device, Gaussians

from ..calls.loan import of_scene
from ..contract.scene import Scene, validate
from ..errors import RunError
from ..inspection.scene_facts import summary, warnings
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, load_pipeline
from ..plugins import Plugins
from ..training.checkpoint import Checkpoint, load_checkpoint
from ..training.initial_model import initial_gaussians, new_model
from ..training.trainer import Iteration, Trainer, maps_of
from .evaluation import evaluate
from .folder import RunFolder, default_folder
from .interrupt import stop_on_interrupt
from .metrics_log import MetricsLog
from .origin.inputs import changed_inputs, input_digests, listed
from .progress import TrainingProgress
from .results import finish
from .run import CHECKPOINT, Run, Stages

Observer = Callable[[Iteration], bool | None]
"""What is told of each iteration; False stops training after it."""
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
    observer: Observer | None = None,
) -> Run:
    """Train a pipeline.

    Nothing is written before the scene, the points and the Gaussians are there and valid.

    Args:
        out: the run folder, or what names it; None writes nothing at all.
        console: is told how it goes.
        scene: in place of what the pipeline's loader would load; valid.

    Returns:
        The run; not `finished` after Ctrl-C or at the observer's wish, with a checkpoint in its folder.

    Raises:
        ExplainedError: whatever went wrong.
    """
    if isinstance(out, Path):
        RunFolder.check_vacant(out)
    run, trainer = _begun(pipeline, scene, device, console)
    if out is not None:
        run.keep_in(out if isinstance(out, Path) else out(pipeline, run.scene))
    writing = f"; writing {run.folder.path}" if run.folder else ""
    console.print(f"{run.initialization['points']:,} points; {device.name}{writing}")
    _train_to_end(run, trainer, console, observer)
    return run


def resume(
    path: Path,
    *,
    plugins: Plugins,
    device: Device,
    console: Console,
    scene: Scene | None = None,
    observer: Observer | None = None,
    accept_changed_inputs: bool = False,
) -> Run:
    """Go on with a run from its checkpoint, to the same end as if it had never stopped.

    Args:
        accept_changed_inputs: go on with other photographs, cameras or model files than it began with.

    Raises:
        ExplainedError: the folder is no run, has no checkpoint, or whatever goes wrong later.
    """
    run = open_run(
        path,
        plugins=plugins,
        device=device,
        scene=scene,
        accept_changed_inputs=accept_changed_inputs,
    )
    run.keep_changes()
    checkpoint = run.checkpoint()
    maps = maps_of(checkpoint.part("maps"))
    trainer = Trainer(run.pipeline.training, run.parts, run.scene, run.model, maps)
    trainer.restore(checkpoint.iteration, checkpoint.part)
    run.checkpoint = lambda: _checkpoint(run, trainer)
    run.folder_or_refuse().forget_metrics_after(checkpoint.iteration)
    console.print(
        f"going on after iteration {checkpoint.iteration} of {run.pipeline.training.iterations}"
    )
    _train_to_end(run, trainer, console, observer)
    return run


def open_run(
    path: Path,
    *,
    plugins: Plugins,
    device: Device,
    scene: Scene | None = None,
    accept_changed_inputs: bool = False,
) -> Run:
    """Read a run folder: its pipeline, scene and newest checkpoint.

    Args:
        scene: in place of what the pipeline's loader would load; valid.

    Raises:
        ExplainedError: one of them cannot be read, or the scene or a model file is another than when
            the run began, and that was not accepted.
    """
    folder = RunFolder.existing(path)
    pipeline = load_pipeline(folder.pipeline, plugins)
    checkpoint = load_checkpoint(path / CHECKPOINT)
    parts = Parts(pipeline, device)
    begin = monotonic()
    scene = scene or load_scene(parts)
    loading = monotonic() - begin
    before, _ = folder.inputs()
    changed = () if before is None else changed_inputs(before, input_digests(scene, pipeline))
    if changed and not accept_changed_inputs:
        raise RunError(
            f"the run was made from other inputs; changed: {listed(changed)}",
            where=str(path),
            fix="bring back what it was made from, train anew, or go on with --accept-changed-inputs",
        )
    facts = folder.initialization()
    return Run(
        pipeline,
        parts,
        scene,
        new_model(Gaussians(**checkpoint.part("model")), pipeline.training, device),
        checkpoint=lambda: checkpoint,
        iteration=checkpoint.iteration,
        initialization=facts,
        seconds=Stages(loading, float(facts.get("seconds", 0.0)), checkpoint.seconds),
        folder=folder,
        changed=changed,
    )


def load_scene(parts: Parts) -> Scene:
    """Let the scene loader load, and validate what it returns."""
    loader = parts.one("scene")
    with loader.at_work():
        return validate(loader.component.load())


def _begun(
    pipeline: Pipeline, scene: Scene | None, device: Device, console: Console
) -> tuple[Run, Trainer]:
    """The first Gaussians, and the trainer that is about to train them."""
    begin = monotonic()
    parts = Parts(pipeline, device)
    scene = scene or load_scene(parts)
    console.print(summary(scene))
    for warning in warnings(scene):
        console.print(f"warning: {warning}")
    had_scene = monotonic()
    initializer = parts.one("initializer")
    known = scene.for_training()
    with initializer.at_work(lent=of_scene(known)):
        points = initializer.component.initialize(known, parts.priors)
        gaussians = initial_gaussians(points, pipeline.training)
    model = new_model(gaussians, pipeline.training, device)
    seconds = Stages(had_scene - begin, monotonic() - had_scene)
    facts = {
        "initializer": initializer.item.name,
        "points": len(points),
        "seconds": round(seconds.initialization, 3),
    }
    facts |= {name: value for name, value in points.facts.items() if name not in facts}
    trainer = Trainer(pipeline.training, parts, scene, model, points.maps)
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


def _train_to_end(run: Run, trainer: Trainer, console: Console, observer: Observer | None) -> None:
    """Train, observe, and write the results if the end was reached and there is a folder for them."""
    settings = run.pipeline.training
    metrics = MetricsLog(run.add_metrics)
    with (
        stop_on_interrupt() as stop,
        TrainingProgress(trainer.iteration, settings.iterations, console) as progress,
    ):
        begin = monotonic()
        for done in trainer.run():
            run.seconds.training += monotonic() - begin
            run.iteration = done.number
            progress.update(done.number, done.loss, done.gaussians)
            metrics.add(done, run.seconds.training, last=done.number == settings.iterations)
            if _due(done.number, settings.evaluate_every):
                scores = evaluate(run.model, run.scene, run.scene.test, run.parts["metrics"])
                metrics.write({"iteration": done.number, "test": scores.mean})
            wanted = observer is None or observer(done) is not False
            if stop.requested or not wanted:
                break
            if _due(done.number, settings.checkpoint_every):
                run.save_checkpoint()
            begin = monotonic()
        run.save_checkpoint()
    if run.finished and run.folder is not None:
        finish(run)


def _checkpoint(run: Run, trainer: Trainer) -> Checkpoint:
    return Checkpoint(trainer.iteration, run.seconds.training, trainer.state())


def _due(iteration: int, every: int) -> bool:
    return every > 0 and iteration % every == 0
