"""Options of both `train` and `resume`, including those of plugins."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from ..contract.command import TrainOption, TrainRequest
from ..plugins.commands import train_options
from .output import positive_seconds

if TYPE_CHECKING:
    from rich.console import Console

    from ..runs.options import RunOptions


def add_run_options(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add --check-plugins and --hang-after, and the options that plugins add to the verb."""
    parser.add_argument(
        "--check-plugins",
        action="store_true",
        help="compare photographs, cameras and Gaussians before and after each call into a plugin (slower)",
    )
    parser.add_argument(
        "--hang-after",
        type=positive_seconds,
        metavar="SECONDS",
        help="end the run if one call into a plugin takes longer (default: only warn, after 60)",
    )
    for option in train_options(verb):
        option.add_arguments(parser)


def given_options(arguments: argparse.Namespace, output: Console) -> RunOptions:
    """Return the options of the command line, except --hang-after, which the verbs apply."""
    from ..runs.options import RunOptions

    return RunOptions(
        progress=output,
        device=arguments.device,
        check_plugins=arguments.check_plugins,
        accept_changed_inputs=getattr(arguments, "accept_changed_inputs", False),
    )


@contextmanager
def running(
    extra: Sequence[TrainOption], request: TrainRequest, options: RunOptions
) -> Iterator[RunOptions]:
    """Enter the contexts of all train options, by name, and yield the final options."""
    with ExitStack() as stack:
        for option in extra:
            options = stack.enter_context(option.running(request, options))
        yield options
