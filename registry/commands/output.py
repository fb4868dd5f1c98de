"""What the verbs share: consoles and arguments."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

Verbs = Any
"""argparse's own type for a set of verbs is private."""


def console() -> Console:
    """Standard output, as it is now."""
    from ..terminal import PlainConsole

    return PlainConsole(markup=False, highlight=False, soft_wrap=True)


def error_console() -> Console:
    """Standard error, as it is now."""
    from ..terminal import PlainConsole

    return PlainConsole(stderr=True, markup=False, highlight=False, soft_wrap=True)


def add_verb(verbs: Verbs, name: str, help_text: str, epilog: str) -> argparse.ArgumentParser:
    """A verb's parser; its `help_text` is also the first line of its own help."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=help_text,
        description=help_text[:1].upper() + help_text[1:] + ".",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser


def add_device(parser: argparse.ArgumentParser) -> None:
    """The option --device."""
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="part of the OpenCL device's or platform's name; `stereogs doctor` lists them",
    )


def add_accept_changed_inputs(parser: argparse.ArgumentParser) -> None:
    """The option --accept-changed-inputs."""
    parser.add_argument(
        "--accept-changed-inputs",
        action="store_true",
        help="go on although photographs, cameras or model files are not those that the run began with",
    )
