"""The options `--require-all-photos` and `--test-every` of `check` and `train`, for scenes of photographs."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from ...command_line.command import TrainOption

if TYPE_CHECKING:
    from registry.runs.options import RunOptions

    from ...command_line.command import TrainRequest


class PhotoOptions(TrainOption):
    """Settings of the scene as options; each is a value of `--set`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options."""
        add_photo_options(parser)

    def running(
        self, request: TrainRequest, options: RunOptions
    ) -> AbstractContextManager[RunOptions]:
        """Change nothing: the pipeline has the settings."""
        return nullcontext(options)


def add_photo_options(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser that has `--set`."""
    parser.add_argument(
        "--require-all-photos",
        action="append_const",
        dest="set",
        default=[],
        const="scene.require_all_photos=true",
        help="stop if a photograph does not connect to the others (default: leave it out with a warning)",
    )
    parser.add_argument(
        "--test-every",
        action="append",
        dest="set",
        default=[],
        type=_test_every,
        metavar="N",
        help="hold out every N-th photograph and score new views with it; 0 holds out none (default: 0; for "
        "data sets with cameras 8, or 0 for fewer than eight photographs)",
    )


def _test_every(text: str) -> str:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 0 or more")
    return f"scene.test_every={text}"
