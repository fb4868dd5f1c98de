"""View a run or a PLY file in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from registry.toolkit.cache.remote import on_this_machine

from ...command_line.arguments import add_accept_changed, add_device, add_scene_folder
from ...command_line.command import Command
from ...command_line.output import console
from . import PORT, import_viser

if TYPE_CHECKING:
    from .subject import Subject

_EPILOG = """\
examples:
  stereogs view runs/3dgs-fern
  stereogs view scene.ply --port 9000

Needs the extra `viewer` (pip install 'stereogs-plugins[viewer]'). Only this machine can open the page;
through ssh: ssh -L 8080:localhost:8080 HOST. Ctrl-C stops the server.
"""


class View(Command):
    epilog = _EPILOG
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "subject", type=Path, metavar="RUN|PLY", help="a run folder or a PLY file"
        )
        parser.add_argument(
            "--port",
            type=int,
            default=PORT,
            metavar="N",
            help=f"first port to try (default {PORT}); if it is in use, the next free one",
        )
        add_scene_folder(parser)
        add_accept_changed(parser, "inputs")
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Serve the page until Ctrl-C."""
        import_viser()  # fails before a scene is loaded

        subject = _subject(arguments)
        from .viewer import Viewer

        viewer = Viewer(subject, arguments.port)
        console().print(f"{subject.name} is at {viewer.url} (press Ctrl-C to stop)")
        try:
            viewer.serve_until_interrupted()
        finally:
            viewer.close()
        return 0


def _subject(arguments: argparse.Namespace) -> Subject:
    from .subject import of_file, of_run

    if arguments.subject.suffix.lower() == ".ply":
        from core_rasterizer import open_device

        return of_file(on_this_machine(arguments.subject), open_device(arguments.device))
    from ...session import open_run

    run = open_run(
        arguments.subject,
        scene=arguments.scene,
        photographs=False,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )
    return of_run(run)
