"""Suggest which picture of a scene to take next."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from registry.messages.suggestions import counted
from registry.toolkit.cache.remote import on_this_machine

from ...command_line.arguments import add_run, open_given
from ...command_line.command import Command
from ...command_line.output import console, report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

_EPILOG = """\
examples:
  stereogs next runs/fern                             where to stand for the next three pictures
  stereogs next runs/fern --count 1
  stereogs next runs/fern --poses poses.json          which of these cameras to photograph from
  stereogs next runs/fern --pictures train_views=0    which of the scene's other pictures to train on

Writes into RUN/next a picture of what would be seen from each place, with the parts hatched that are guessed
today, and next.json; the run's page shows the places under "Seen by". --poses reads a file like
transforms.json: {"frames": [{"transform_matrix": 4 x 4}]}, camera-to-world with OpenGL axes, in the world of
the run's scene.
"""


class Next(Command):
    epilog = _EPILOG
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--count",
            type=_positive,
            default=3,
            metavar="N",
            help="number of suggestions (default 3)",
        )
        source = parser.add_mutually_exclusive_group()
        source.add_argument(
            "--poses",
            type=on_this_machine,
            metavar="FILE",
            help="choose from the cameras in a JSON file",
        )
        source.add_argument(
            "--pictures",
            nargs="*",
            metavar="SETTING=VALUE",
            help="choose from pictures of the scene that the run did not train on: its test views, and those "
            "that the scene's loader returns with these settings; write it after RUN",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the suggestions and where their files are."""
        output = console()
        run = open_given(arguments)

        from . import photographs_of, suggestions
        from .given import other_pictures, read_poses
        from .written import write

        names: Sequence[str] | None = None
        cameras: Sequence[Camera] | None = None
        if arguments.poses is not None:
            names, cameras = read_poses(arguments.poses, run.scene.train[0].camera)
        elif arguments.pictures is not None:
            names, cameras = other_pictures(run, arguments.pictures)
        photographs = photographs_of(run)
        found = suggestions(run, photographs, cameras, arguments.count)
        place = run.folder_or_refuse()
        folder = place.folder("next")
        write(run, found, names, folder)
        for number, view in enumerate(found, start=1):
            name = f"{names[view.index]}: " if names is not None else ""
            output.print(f"{number}  {name}{view.words}")
            output.print(
                f"   confirms {view.gain:.0%} of what is unknown now{_doubt(view.overlap)}"
            )
        output.print(photographs.step_words)
        output.print(f"{counted(len(found), 'picture')} and next.json in {folder}")
        if not run.finished or not place.results():
            return 0
        return report(run, place, run.parts["reports"])


def _doubt(overlap: float) -> str:
    """Return a warning for a picture that may not connect to the photographs."""
    from .gain import OVERLAP

    if overlap >= OVERLAP:
        return ""
    return f"; only {overlap:.0%} of it is in other photographs: take one halfway too"


def _positive(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of pictures")
    return value
