"""Repeat a failed iteration."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError

from ..command_line.arguments import add_accept_changed, add_device, add_scene_folder
from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from core_rasterizer import Device
    from registry.discovery import Plugins

_EPILOG = """\
examples:
  stereogs replay runs/3dgs-fern/failures/iteration-0000021
  STEREOGS_TRACE=1 stereogs replay runs/3dgs-fern/failures/iteration-0000021

A run whose iteration fails saves the state before it. This command repeats the iteration: it reproduces
the error, or succeeds if the cause has been fixed.
"""


@dataclass(frozen=True)
class Failure:
    """An iteration that failed before, with the error `what`, and succeeds now."""

    iteration: int
    what: str


class Replay(Command):
    epilog = _EPILOG
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "failure",
            type=Path,
            metavar="FAILURE",
            help="a folder in RUN/failures, or a file in it",
        )
        add_scene_folder(parser)
        add_accept_changed(parser, "inputs")
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Repeat the iteration; return 0 if it succeeds."""
        from core_rasterizer import open_device
        from registry.discovery import Plugins

        failure = repeat_failure(
            arguments.failure,
            plugins=Plugins(),
            device=open_device(arguments.device),
            scene=arguments.scene,
            accept_changed_inputs=arguments.accept_changed_inputs,
        )
        console().print(
            f"iteration {failure.iteration} succeeds now; it had failed with: {failure.what}"
        )
        return 0


def repeat_failure(
    place: Path,
    *,
    plugins: Plugins,
    device: Device,
    scene: Path | None = None,
    accept_changed_inputs: bool = False,
) -> Failure:
    """Repeat an iteration that failed.

    Args:
        place: a folder in RUN/failures, or a file in it.
        scene: folder of the scene's data, if it was moved.
        accept_changed_inputs: continue even if photographs, cameras or model files have changed.

    Returns:
        The earlier failure, if the iteration succeeds now.

    Raises:
        ExplainedError: the iteration fails again; or the place does not hold a failed iteration.
    """
    from registry.pipeline.parts import Parts, load_scene
    from registry.pipeline.pipeline import load_pipeline
    from registry.runs.folder import RunFolder
    from registry.runs.opening import FAILURES
    from registry.runs.origin import refuse_changed_inputs
    from registry.runs.sources.places import in_its_place
    from registry.toolkit.cache.remote import url_of
    from registry.training.assembly import restore
    from registry.training.checkpoint import explain_misfit, read_checkpoint

    if url_of(place):
        run = next((up.parent for up in place.parents if up.name == FAILURES), place)
        place = RunFolder.existing(run).path / place.relative_to(run)
    place = place.parent if place.is_file() else place
    fix = f"give a folder in RUN/{FAILURES}; `stereogs resume RUN` continues a run"
    if not (place / "manifest.json").is_file():
        what = "it has no manifest.json" if place.is_dir() else "there is no such folder"
        raise RunError(f"this is not a failed iteration: {what}", where=str(place), fix=fix)
    checkpoint = read_checkpoint(place)
    pipeline = load_pipeline(place / "pipeline.yaml", plugins)
    notes, last = checkpoint.notes, pipeline.training.iterations
    iteration, inputs = notes.get("iteration"), notes.get("inputs")
    if type(iteration) is not int or not isinstance(inputs, dict):
        what = "this is the checkpoint of a run, not of a failed iteration"
        raise RunError(what, where=str(place), fix=fix)
    if not checkpoint.iteration < iteration <= last:
        what = (
            f"iteration {iteration} does not come after {checkpoint.iteration} in a run of {last}"
        )
        raise RunError(what, where=str(place), fix=fix)
    pipeline = in_its_place(pipeline, RunFolder(place.absolute().parent.parent), scene)
    parts = Parts(pipeline, device)
    loaded = load_scene(parts.one("scene"))
    if not accept_changed_inputs:
        refuse_changed_inputs(inputs, loaded, pipeline, place)
    with explain_misfit(place):
        trainer = restore(parts, loaded, checkpoint)
    next(done for done in trainer.run() if done.number == iteration)
    return Failure(iteration, str(notes.get("what")))
