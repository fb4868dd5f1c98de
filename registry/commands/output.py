"""Consoles and arguments that several verbs use."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..messages.help_text import HelpFormatter

if TYPE_CHECKING:
    from ..messages.terminal import PlainConsole
    from ..runs.run import Run


def console() -> PlainConsole:
    """Return a console for the current standard output."""
    from ..messages.terminal import PlainConsole

    return PlainConsole(markup=False, highlight=False, soft_wrap=True)


def error_console() -> PlainConsole:
    """Return a console for the current standard error."""
    from ..messages.terminal import PlainConsole

    return PlainConsole(stderr=True, markup=False, highlight=False, soft_wrap=True)


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
        help="part of the OpenCL device's or platform's name; `stereogs doctor` lists them",
    )


def positive_seconds(text: str) -> float:
    """Parse a positive number of seconds."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of seconds")
    return value


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the argument RUN and the options with which `open_given` opens it."""
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
    add_accept_changed_inputs(parser)
    add_device(parser)


def open_given(arguments: argparse.Namespace) -> Run:
    """Open the run given by the arguments of `add_run`."""
    from ..session import open_run

    return open_run(
        arguments.run_folder,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )


def add_accept_changed_inputs(parser: argparse.ArgumentParser) -> None:
    """Add the option --accept-changed-inputs."""
    parser.add_argument(
        "--accept-changed-inputs",
        action="store_true",
        help="continue even if photographs, cameras or model files have changed since the run began",
    )
