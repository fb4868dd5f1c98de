"""What the verbs share: consoles and arguments."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..messages.help_text import HelpFormatter

if TYPE_CHECKING:
    from ..messages.terminal import PlainConsole
    from ..runs.run import Run

Verbs = Any
"""argparse's own type for a set of verbs is private."""


def console() -> PlainConsole:
    """Standard output, as it is now."""
    from ..messages.terminal import PlainConsole

    return PlainConsole(markup=False, highlight=False, soft_wrap=True)


def error_console() -> PlainConsole:
    """Standard error, as it is now."""
    from ..messages.terminal import PlainConsole

    return PlainConsole(stderr=True, markup=False, highlight=False, soft_wrap=True)


def add_verb(verbs: Verbs, name: str, help_text: str, epilog: str) -> argparse.ArgumentParser:
    """A verb's parser; its `help_text` is also the first line of its own help."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=help_text,
        description=help_text[:1].upper() + help_text[1:] + ".",
        epilog=epilog,
        formatter_class=HelpFormatter,
    )
    return parser


def add_device(parser: argparse.ArgumentParser) -> None:
    """The option --device."""
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="part of the OpenCL device's or platform's name; `stereogs doctor` lists them",
    )


def add_watching(parser: argparse.ArgumentParser) -> None:
    """The options --view, --check-plugins and --hang-after; `watching` takes what the last two were given."""
    parser.add_argument(
        "--view",
        action="store_true",
        help="show the scene in the browser while it trains, and after that until Ctrl-C",
    )
    parser.add_argument(
        "--check-plugins",
        action="store_true",
        help="compare photographs, cameras and Gaussians around each call into a plugin (slower)",
    )
    parser.add_argument(
        "--hang-after",
        type=positive_seconds,
        metavar="SECONDS",
        help="end the run if one call into a plugin takes longer (default: only tell, after 60)",
    )


def watching(arguments: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `stereogs.train` and `resume` from the options that `add_watching` adds."""
    return {"check_plugins": arguments.check_plugins, "hang_after": arguments.hang_after}


def positive_seconds(text: str) -> float:
    """A number of seconds, as an option takes it."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of seconds")
    return value


def add_run(parser: argparse.ArgumentParser) -> None:
    """A run folder to be looked at, and what goes with it; `open_given` opens it."""
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
    add_accept_changed_inputs(parser)
    add_device(parser)


def open_given(arguments: argparse.Namespace) -> Run:
    """The run that the options of `add_run` name."""
    from ..session import open_run

    return open_run(
        arguments.run_folder,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )


def add_accept_changed_inputs(parser: argparse.ArgumentParser) -> None:
    """The option --accept-changed-inputs."""
    parser.add_argument(
        "--accept-changed-inputs",
        action="store_true",
        help="go on although photographs, cameras or model files are not those that the run began with",
    )
