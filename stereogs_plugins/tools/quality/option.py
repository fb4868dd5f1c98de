"""The options `--seconds` and `--quality` of `train`, and the pipeline for a folder of photographs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from registry import Register, RunError, TrainOption, hookimpl
from registry.commands import console, positive_seconds

from .table import QUALITIES, SHORT

if TYPE_CHECKING:
    from registry.commands import TrainRequest
    from registry.runs import Fit, RunOptions

LENGTH = "training.iterations"


class Quality(TrainOption):
    """The options `--seconds` and `--quality`."""

    folder_pipeline = SHORT

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options, which exclude each other."""
        length = parser.add_mutually_exclusive_group()
        length.add_argument(
            "--seconds",
            type=positive_seconds,
            metavar="N",
            help="finish the whole run within N seconds, from the command to the last file; trains at most "
            "as many iterations as the pipeline specifies",
        )
        length.add_argument(
            "--quality", choices=QUALITIES, help="which pipeline trains a folder (default: good)"
        )

    def check(self, arguments: argparse.Namespace) -> None:
        """Refuse --quality with a pipeline, and both options with a number of iterations."""
        if arguments.quality and arguments.pipeline and not arguments.pipeline.is_dir():
            raise RunError(
                f"--quality conflicts with the pipeline {arguments.pipeline}",
                where=f"--quality {arguments.quality}",
                fix="give a folder of photographs or data, or --seconds",
            )
        if (arguments.seconds or arguments.quality) and _iterations_given(arguments):
            option = "--seconds" if arguments.seconds else "--quality"
            raise RunError(
                f"{option} conflicts with {LENGTH}",
                where=f"--set {LENGTH}=...",
                fix="remove one of them",
            )

    @contextmanager
    def running(self, request: TrainRequest, options: RunOptions) -> Iterator[RunOptions]:
        """Choose the pipeline or its length once the first Gaussians exist."""
        yield replace(options, fit=_fit(request))


def _iterations_given(arguments: argparse.Namespace) -> bool:
    return any(text.partition("=")[0].strip() == LENGTH for text in arguments.set)


def _fit(request: TrainRequest) -> Fit | None:
    """Return a function that chooses the pipeline or its length; None if both are given."""
    from .fitting import Budget, choose, fit_length

    given, log = request.arguments, console().print
    budget = Budget(given.seconds, request.begin) if given.seconds else None
    if _iterations_given(given) or request.load is None:
        return None
    if request.pipeline_named:
        return partial(fit_length, budget=budget, log=log) if budget else None
    return partial(choose, wanted=budget or given.quality or "good", load=request.load, log=log)


@hookimpl
def stereogs_register_train_options(register: Register[TrainOption]) -> None:
    register("quality", Quality)
