"""The options `--seconds`, `--quality` and `--size` of `train`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from registry import RunError

from ..command_line.arguments import positive_seconds
from ..command_line.output import console
from .table import QUALITIES

if TYPE_CHECKING:
    from ..command_line.command import TrainRequest
    from .fitting import Fit

LENGTH, SIZE = "training.iterations", "scene.max_size"


def add_quality(parser: argparse.ArgumentParser) -> None:
    """Add the options; the first two exclude each other."""
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--seconds",
        type=positive_seconds,
        metavar="N",
        help="finish the whole run within N seconds, from the command to the last file, with fewer frames "
        "of a video, smaller photographs and fewer iterations, but at least 30",
    )
    length.add_argument(
        "--quality", choices=QUALITIES, help="which pipeline trains a folder (default: good)"
    )
    parser.add_argument(
        "--size",
        action=_Size,
        type=int,
        metavar="PIXELS",
        help="longer side of the training photographs, at most (--set scene.max_size=PIXELS); default "
        "for photographs without cameras: 800, less if time or memory is short",
    )


def given_fit(request: TrainRequest) -> Fit:
    """Return what chooses size, pipeline and length for a command line.

    Raises:
        RunError: --quality is given with a pipeline, or an option with a number of iterations.
    """
    _check(request)
    from .fitting import Fit, WithQuality
    from .within_seconds import Budget, WithinSeconds

    given, log, load = request.arguments, console().print, request.load
    is_folder = not request.pipeline_named
    kept = _changed(given)
    adapts = is_folder and not kept & {SIZE, "scene.downsample"}
    chosen = {"size": given.size, "adapts_size": adapts, "kept": kept, "device": given.device}
    if given.seconds:
        budget = Budget(given.seconds, request.begin)
        return WithinSeconds(log, **chosen, budget=budget, load=load if is_folder else None)
    if not is_folder or load is None:
        return Fit(log, **chosen)
    return WithQuality(log, **chosen, load=load, quality=given.quality or "good")


class _Size(argparse.Action):
    """Stores the size, and adds the setting of the scene that it stands for."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        namespace.size = values
        namespace.set = [*namespace.set, f"{SIZE}={values}"]


def _check(request: TrainRequest) -> None:
    given = request.arguments
    if given.quality and request.pipeline_named:
        raise RunError(
            f"--quality conflicts with the pipeline {given.pipeline}",
            where=f"--quality {given.quality}",
            fix="give a folder of photographs or data, or --seconds",
        )
    if (given.seconds or given.quality) and LENGTH in _changed(given):
        option = "--seconds" if given.seconds else "--quality"
        raise RunError(
            f"{option} conflicts with {LENGTH}",
            where=f"--set {LENGTH}=...",
            fix="remove one of them",
        )


def _changed(arguments: argparse.Namespace) -> set[str]:
    """Names of the settings that --set changes."""
    return {text.partition("=")[0].strip() for text in arguments.set}
