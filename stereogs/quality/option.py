"""The options `--seconds`, `--quality` and `--size` of `train`, and the pipeline for a folder."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from registry import RunError

from ..command_line.arguments import positive_seconds
from ..command_line.command import TrainOption
from ..command_line.output import console
from .table import QUALITIES, SHORT

if TYPE_CHECKING:
    from registry.runs.options import RunOptions

    from ..command_line.command import TrainRequest
    from .fitting import SizePlan

LENGTH, SIZE = "training.iterations", "scene.max_size"


class Quality(TrainOption):
    """The options `--seconds`, `--quality` and `--size`."""

    folder_pipeline = SHORT

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options, which exclude each other."""
        length = parser.add_mutually_exclusive_group()
        length.add_argument(
            "--seconds",
            type=positive_seconds,
            metavar="N",
            help="finish the whole run within N seconds, from the command to the last file, with smaller "
            "photographs and fewer iterations, but at least 30",
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

    @contextmanager
    def running(self, request: TrainRequest, options: RunOptions) -> Iterator[RunOptions]:
        """Choose size, pipeline and length during the run; report afterwards what it took.

        Raises:
            RunError: --quality is given with a pipeline, or an option with a number of iterations.
        """
        _check(request)
        plan = _plan(request)
        yield replace(options, fit=plan)
        if plan.run is not None and plan.run.finished:
            for line in plan.closing():
                console().print(line)


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
    if (given.seconds or given.quality) and _iterations_given(given):
        option = "--seconds" if given.seconds else "--quality"
        raise RunError(
            f"{option} conflicts with {LENGTH}",
            where=f"--set {LENGTH}=...",
            fix="remove one of them",
        )


def _iterations_given(arguments: argparse.Namespace) -> bool:
    return LENGTH in _changed(arguments)


def _changed(arguments: argparse.Namespace) -> set[str]:
    """Names of the settings that --set changes."""
    return {text.partition("=")[0].strip() for text in arguments.set}


def _plan(request: TrainRequest) -> SizePlan:
    """Return the plan for a command line: a folder has its size and its pipeline chosen."""
    from .fitting import Budget, SizePlan, WithinSeconds, WithQuality

    given, log, load = request.arguments, console().print, request.load
    is_folder = not request.pipeline_named
    adapts = is_folder and not _changed(given) & {SIZE, "scene.downsample"}
    chosen = {"size": given.size, "adapts_size": adapts, "device": given.device}
    if given.seconds:
        budget = Budget(given.seconds, request.begin)
        return WithinSeconds(log, **chosen, budget=budget, load=load if is_folder else None)
    if not is_folder or load is None or _iterations_given(given):
        return SizePlan(log, **chosen)
    return WithQuality(log, **chosen, load=load, quality=given.quality or "good")
