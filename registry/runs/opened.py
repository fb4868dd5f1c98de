"""A run folder opened again: to go on with it, to score it, to look at it."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

from core_rasterizer import Device, Gaussians

from ..contract.scene import Scene
from ..errors import RunError
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, load_pipeline
from ..plugins.discovery import Plugins
from ..training.checkpoint import CHECKPOINT, Checkpoint, explain_misfit, load_checkpoint
from ..training.initial_model import new_model
from .folder import RunFolder
from .origin.inputs import changed_inputs, input_digests, load_scene, refuse_changed
from .origin.unedited import check_unedited
from .results import check_recorded_hash
from .run import Run, Stages


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
        ExplainedError: one of them cannot be read; the pipeline or the checkpoint is not the run's own;
            or the scene or a model file is another than when the run began, and that was not accepted.
    """
    folder = RunFolder.existing(path)
    pipeline = load_pipeline(folder.pipeline, plugins)
    checkpoint = load_checkpoint(path / CHECKPOINT)
    _check_own(folder, checkpoint, pipeline, plugins)
    parts = Parts(pipeline, device)
    begin = monotonic()
    scene = scene or load_scene(parts)
    loading = monotonic() - begin
    before, _ = folder.inputs()
    changed = () if before is None else changed_inputs(before, input_digests(scene, pipeline))
    if not accept_changed_inputs:
        refuse_changed(changed, path)
    facts = folder.initialization()
    with explain_misfit(path / CHECKPOINT):
        gaussians = Gaussians(**checkpoint.part("model"))
        model = new_model(gaussians, pipeline.training, device)
    recorded = folder.results()
    if recorded.get("iterations") == checkpoint.iteration:
        check_recorded_hash(recorded, model.digest(), path)
    return Run(
        pipeline,
        parts,
        scene,
        model,
        checkpoint=lambda: checkpoint,
        iteration=checkpoint.iteration,
        initialization=facts,
        seconds=Stages(loading, float(facts.get("seconds", 0.0)), checkpoint.seconds),
        folder=folder,
        changed=changed,
        identity=folder.identity,
        kept=checkpoint.iteration,
    )


def _check_own(
    folder: RunFolder, checkpoint: Checkpoint, pipeline: Pipeline, plugins: Plugins
) -> None:
    """Refuse a checkpoint that this run, with this pipeline, cannot have written."""
    if "" not in (folder.identity, checkpoint.run) and folder.identity != checkpoint.run:
        raise RunError(
            "the checkpoint is another run's",
            where=str(folder.path / CHECKPOINT),
            fix="bring the run's own checkpoint back; provenance.json and manifest.json name the run",
        )
    check_unedited(folder.pipeline, pipeline, checkpoint.pipeline, plugins)
    if checkpoint.iteration > pipeline.training.iterations:
        raise RunError(
            f"the checkpoint says iteration {checkpoint.iteration}, "
            f"and the run has {pipeline.training.iterations}",
            where=str(folder.path / CHECKPOINT),
            fix="bring the run's own checkpoint back, or train anew into another folder",
        )
