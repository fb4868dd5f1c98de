"""Runs read back from their folders."""

from __future__ import annotations

from difflib import SequenceMatcher
from pathlib import Path
from time import monotonic
from typing import Any

from core_rasterizer import Device, Gaussians

from ..contract.checks.scene import validate
from ..contract.hook_points import HOOK_POINTS
from ..contract.scene import Scene
from ..errors import RunError
from ..inspection.scene_source import load
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline, build_pipeline, load_pipeline
from ..pipeline.yaml_source import parse
from ..plugins.discovery import Plugins
from ..training.checkpoint import CHECKPOINT, Checkpoint, explain_misfit, load_checkpoint
from ..training.initial_model import new_model
from .folder import RunFolder
from .origin import changed_inputs, input_digests, refuse_changed
from .run import Run, Stages

_OBSERVED = [point.section for point in HOOK_POINTS if point.observes]
"""Sections that may change before a run is resumed: no bit depends on them."""


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
        scene: used instead of the scene that the pipeline loads.

    Raises:
        ExplainedError: one of them cannot be read; the pipeline or the checkpoint belongs to another run; or
            the scene or a model file has changed, and `accept_changed_inputs` is False.
    """
    folder = RunFolder.existing(path)
    pipeline = load_pipeline(folder.pipeline, plugins)
    checkpoint = load_checkpoint(path / CHECKPOINT)
    _check_own(folder, checkpoint, pipeline, plugins)
    parts = Parts(pipeline, device)
    begin = monotonic()
    scene = load(parts.one("scene")) if scene is None else validate(scene)
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
        _check_hash(recorded.get("hash"), model.digest(), path)
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
        saved_iteration=checkpoint.iteration,
    )


def _check_own(
    folder: RunFolder, checkpoint: Checkpoint, pipeline: Pipeline, plugins: Plugins
) -> None:
    """Refuse a checkpoint that this run, with this pipeline, cannot have written."""
    if "" not in (folder.identity, checkpoint.run) and folder.identity != checkpoint.run:
        raise RunError(
            "the checkpoint belongs to another run",
            where=str(folder.path / CHECKPOINT),
            fix="restore the run's own checkpoint; provenance.json and manifest.json name the run",
        )
    _check_unedited(folder.pipeline, pipeline, checkpoint.pipeline, plugins)
    if checkpoint.iteration > pipeline.training.iterations:
        raise RunError(
            f"the checkpoint is of iteration {checkpoint.iteration}, "
            f"but the run has {pipeline.training.iterations}",
            where=str(folder.path / CHECKPOINT),
            fix="restore the run's own checkpoint, or train again into another folder",
        )


def _check_hash(recorded: Any, digest: str, path: Path) -> None:
    """Refuse Gaussians that differ from those that results.json was written for."""
    if recorded not in (None, digest):
        raise RunError(
            f"the Gaussians of the checkpoint, {digest[:12]}..., are not those that results.json "
            f"was written for, {str(recorded)[:12]}...",
            where=str(path),
            fix="restore the changed file; or, if the checkpoint is right, remove results.json "
            f"and call `stereogs eval {path}`",
        )


def _check_unedited(file: Path, now: Pipeline, before: str, plugins: Plugins) -> None:
    """Refuse an edited pipeline. Comments, layout and observers may change.

    Args:
        file: path of the pipeline.
        now: its content.
        before: text of the pipeline that the run was trained with.
    """
    text = file.read_text("utf-8")
    if text == before or _without_observers(now.plain()) == _earlier(before, plugins):
        return
    number, written, was = _first_change(before.splitlines(), text.splitlines())
    raise RunError(
        f"the pipeline was edited after training began: {_quoted(written)} "
        f"in place of {_quoted(was)}",
        where=f"{file}:{number}",
        fix="restore that line, or train the changed pipeline into another folder",
    )


def _without_observers(plain: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in plain.items() if key not in _OBSERVED}


def _earlier(text: str, plugins: Plugins) -> dict[str, Any]:
    """The values of the earlier pipeline; the packages of its observers may be uninstalled."""
    root = parse(text, "pipeline")
    if isinstance(root.content, dict):
        for section in _OBSERVED:
            root.content.pop(section, None)
    return _without_observers(build_pipeline(root, plugins).plain())


def _first_change(before: list[str], now: list[str]) -> tuple[int, list[str], list[str]]:
    """Return the 1-based line of the first change that is not a comment, the new lines, and the old ones."""
    changes = SequenceMatcher(None, before, now, autojunk=False).get_opcodes()
    for kind, first, last, begin, end in changes:
        written, was = _content(now[begin:end]), _content(before[first:last])
        if kind != "equal" and written != was:
            return begin + 1, written, was
    return 1, [], []  # equal lines that today's plugins read differently


def _content(lines: list[str]) -> list[str]:
    return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _quoted(lines: list[str]) -> str:
    return f"`{lines[0]}`" if lines else "nothing"
