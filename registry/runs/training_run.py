"""A whole run: load, initialize, train with observers, evaluate, export. And going on with one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from core_rasterizer import Device, GaussianModel, Gaussians

from ..contract.scene import Scene, validate
from ..errors import RunError
from ..inspection.scene_facts import summary, warnings
from ..pipeline.blame import blame
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, load_pipeline
from ..plugins import Plugins
from ..training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..training.initial_model import initial_gaussians, new_model
from ..training.trainer import Trainer, maps_of
from .evaluation import evaluate
from .folder import RunFolder, default_folder
from .inputs import changed_inputs, input_digests, listed
from .interrupt import stop_on_interrupt
from .metrics_log import MetricsLog
from .progress import TrainingProgress
from .provenance import provenance
from .results import finish

CHECKPOINT = "checkpoint"


@dataclass(frozen=True, eq=False)
class Opened:
    """A run folder's pipeline, scene and Gaussians, ready to go on with."""

    run: RunFolder
    pipeline: Pipeline
    parts: Parts
    scene: Scene
    model: GaussianModel
    checkpoint: Checkpoint
    changed: tuple[str, ...] = ()
    """Inputs that are not those that the run began with, and were accepted."""

    def keep_changes(self) -> None:
        """Write down which inputs have changed, once something is made from them."""
        if self.changed:
            earlier = self.run.inputs()[1]
            names = dict.fromkeys([*earlier, *self.changed])
            self.run.write_inputs(input_digests(self.scene, self.pipeline), [*names])


def start(
    pipeline: Pipeline,
    *,
    device: Device,
    out: Path | None,
    command: Sequence[str],
    console: Console,
) -> tuple[RunFolder, bool]:
    """Train a pipeline into a new run folder.

    Nothing is written before the scene, the points and the Gaussians are there and valid.

    Args:
        out: the run folder; None takes `runs/<pipeline>-<scene>`, numbered if that exists.
        command: the command line, for the provenance.

    Returns:
        The run, and whether it came to its end; False after Ctrl-C, with a checkpoint.

    Raises:
        ExplainedError: whatever went wrong.
    """
    if out is not None:
        RunFolder.check_vacant(out)
    parts = Parts(pipeline, device)
    scene = load_scene(parts)
    console.print(summary(scene))
    for warning in warnings(scene):
        console.print(f"warning: {warning}")
    initializer = parts.one("initializer")
    begin = time.monotonic()
    with blame(initializer.item):
        points = initializer.component.initialize(scene.for_training(), parts.priors)
        gaussians = initial_gaussians(points, pipeline.training)
    model = new_model(gaussians, pipeline.training, device)
    run = RunFolder(out or default_folder(f"{pipeline.name}-{scene.name}"))
    run.create(
        pipeline.to_yaml(),
        provenance(pipeline, device, list(command)),
        input_digests(scene, pipeline),
    )
    facts = {
        "initializer": initializer.item.name,
        "points": len(points),
        "seconds": round(time.monotonic() - begin, 3),
    }
    facts |= {name: value for name, value in points.facts.items() if name not in facts}
    run.write_initialization(facts, points.pictures)
    console.print(f"{len(points):,} points; {device.name}; writing {run.path}")
    trainer = Trainer(pipeline.training, parts, scene, model, points.maps)
    return run, _train_to_end(run, pipeline, trainer, 0.0, console)


def resume(
    path: Path,
    *,
    plugins: Plugins,
    device: Device,
    console: Console,
    accept_changed_inputs: bool = False,
) -> bool:
    """Go on with a run from its checkpoint, to the same end as if it had never stopped.

    Args:
        accept_changed_inputs: go on with other photographs, cameras or model files than it began with.

    Returns:
        Whether it came to its end.

    Raises:
        ExplainedError: the folder is no run, has no checkpoint, or whatever goes wrong later.
    """
    opened = open_run(
        path, plugins=plugins, device=device, accept_changed_inputs=accept_changed_inputs
    )
    trainer = Trainer(
        opened.pipeline.training,
        opened.parts,
        opened.scene,
        opened.model,
        maps_of(opened.checkpoint.part("maps")),
    )
    trainer.restore(opened.checkpoint.iteration, opened.checkpoint.part)
    opened.keep_changes()
    opened.run.forget_metrics_after(opened.checkpoint.iteration)
    console.print(
        f"going on after iteration {opened.checkpoint.iteration} of "
        f"{opened.pipeline.training.iterations}"
    )
    return _train_to_end(opened.run, opened.pipeline, trainer, opened.checkpoint.seconds, console)


def open_run(
    path: Path, *, plugins: Plugins, device: Device, accept_changed_inputs: bool = False
) -> Opened:
    """Read a run folder: its pipeline, scene and newest checkpoint.

    Raises:
        ExplainedError: one of them cannot be read, or the scene or a model file is another than when
            the run began, and that was not accepted.
    """
    run = RunFolder.existing(path)
    pipeline = load_pipeline(run.pipeline, plugins)
    checkpoint = load_checkpoint(path / CHECKPOINT)
    parts = Parts(pipeline, device)
    scene = load_scene(parts)
    before, _ = run.inputs()
    changed = () if before is None else changed_inputs(before, input_digests(scene, pipeline))
    if changed and not accept_changed_inputs:
        raise RunError(
            f"the run was made from other inputs; changed: {listed(changed)}",
            where=str(path),
            fix="bring back what it was made from, train anew, or go on with --accept-changed-inputs",
        )
    gaussians = Gaussians(**checkpoint.part("model"))
    model = new_model(gaussians, pipeline.training, device)
    return Opened(run, pipeline, parts, scene, model, checkpoint, changed)


def load_scene(parts: Parts) -> Scene:
    """Let the scene loader load, and validate what it returns."""
    loader = parts.one("scene")
    with blame(loader.item):
        return validate(loader.component.load())


def _train_to_end(
    run: RunFolder, pipeline: Pipeline, trainer: Trainer, seconds: float, console: Console
) -> bool:
    """Train, observe, and write the results; False if the user stopped it before the end."""
    settings = pipeline.training
    metrics = MetricsLog(run)
    with (
        stop_on_interrupt() as stop,
        TrainingProgress(trainer.iteration, settings.iterations, console) as progress,
    ):
        begin = time.monotonic()
        for done in trainer.run():
            seconds += time.monotonic() - begin
            progress.update(done.number, done.loss, done.gaussians)
            metrics.add(done, seconds, last=done.number == settings.iterations)
            if _due(done.number, settings.evaluate_every):
                scores = evaluate(
                    trainer.model, trainer.scene, trainer.scene.test, trainer.parts["metrics"]
                )
                metrics.write({"iteration": done.number, "test": scores.mean})
            if stop.requested:
                break
            if _due(done.number, settings.checkpoint_every):
                _save(run, trainer, seconds)
            begin = time.monotonic()
        _save(run, trainer, seconds)
    if trainer.iteration < settings.iterations:
        return False
    finish(run, pipeline, trainer.parts, trainer.scene, trainer.model, seconds)
    return True


def _due(iteration: int, every: int) -> bool:
    return every > 0 and iteration % every == 0


def _save(run: RunFolder, trainer: Trainer, seconds: float) -> None:
    state: dict[str, Any] = trainer.state()
    save_checkpoint(Checkpoint(trainer.iteration, seconds, state), run.folder(CHECKPOINT))
