"""Arguments that several verbs have."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.messages.terminal import HelpFormatter

from .command import TrainOption, TrainRequest
from .installed import train_options

if TYPE_CHECKING:
    from rich.console import Console

    from registry.runs.options import RunOptions
    from registry.runs.run import Run


def add_verb(verbs: Any, name: str, summary: str, epilog: str) -> argparse.ArgumentParser:
    """Add the parser of a verb; its help begins with the summary.

    Args:
        verbs: from `add_subparsers`, whose type is private.
    """
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=summary,
        description=summary[:1].upper() + summary[1:] + ".",
        epilog=epilog,
        formatter_class=HelpFormatter,
    )
    return parser


def add_device(parser: argparse.ArgumentParser) -> None:
    """Add the option --device."""
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="part of a device's or platform's name or driver version; see `stereogs doctor`",
    )


def add_changes(parser: argparse.ArgumentParser) -> None:
    """Add --set and --disable, which change a pipeline."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        help="change a setting; list items go by name: regularizers.stereo_depth.weight=2",
    )
    parser.add_argument(
        "--disable", action="append", default=[], metavar="NAME", help="switch a component off"
    )


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the argument RUN and the options with which `open_given` opens it."""
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder, or its address")
    add_scene_folder(parser)
    add_accept_changed(parser, "inputs")
    add_device(parser)


def add_scene_folder(parser: argparse.ArgumentParser) -> None:
    """Add --scene, the folder of a run's data."""
    parser.add_argument(
        "--scene",
        type=Path,
        metavar="FOLDER",
        help="the folder of the run's photographs, if they were moved since the training",
    )


def open_given(arguments: argparse.Namespace, *, photographs: bool = True) -> Run:
    """Open the run given by the arguments of `add_run`; `photographs` as for `open_run`."""
    from ..session import open_run

    return open_run(
        arguments.run_folder,
        scene=arguments.scene,
        photographs=photographs,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )


def add_accept_changed(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --accept-changed-inputs or --accept-changed-plugins."""
    changed = {
        "inputs": "photographs, cameras or model files have changed since the run began",
        "plugins": "a plugin's package has another version or code than when the run was written",
    }
    help_text = f"continue even if {changed[what]}"
    parser.add_argument(f"--accept-changed-{what}", action="store_true", help=help_text)


def positive_seconds(text: str) -> float:
    """Parse a positive number of seconds."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of seconds")
    return value


def add_run_options(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add --check-plugins, --hang-after, and the options that plugins add to the verb."""
    parser.add_argument(
        "--check-plugins",
        action="store_true",
        help="compare all data before and after each call into a plugin, and repeat some calls (slower)",
    )
    parser.add_argument(
        "--hang-after",
        type=positive_seconds,
        metavar="SECONDS",
        help="end the run if one call into a plugin takes longer (default: only warn)",
    )
    parser.add_argument(
        "--recover",
        action="store_true",
        help="if a parameter is not finite, go back to the last checkpoint with half the learning rates",
    )
    for option in train_options(verb):
        option.add_arguments(parser)


@contextmanager
def run_options(
    request: TrainRequest, extra: Sequence[TrainOption], output: Console
) -> Iterator[RunOptions]:
    """Yield the options of the command line, except --hang-after, within the contexts of `extra`."""
    from registry.runs.options import RunOptions

    arguments = request.arguments
    options = RunOptions(
        progress=output,
        device=arguments.device,
        check_plugins=arguments.check_plugins,
        recover=arguments.recover,
        scene_folder=getattr(arguments, "scene", None),
        accept_changed_inputs=getattr(arguments, "accept_changed_inputs", False),
        accept_changed_plugins=getattr(arguments, "accept_changed_plugins", False),
    )
    with ExitStack() as stack:
        for option in extra:
            options = stack.enter_context(option.running(request, options))
        yield options
