"""Look at a run or a PLY file in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from registry import Command, Register, hookimpl
from registry.commands import add_accept_changed_inputs, add_device, console

if TYPE_CHECKING:
    from .subject import Subject

PORT = 8080

_EPILOG = """\
examples:
  stereogs view runs/3dgs-fern
  stereogs view scene.ply --port 9000

It needs the extra `viewer` (pip install 'stereogs-plugins[viewer]'). The page is for this machine alone;
through ssh: ssh -L 8080:localhost:8080 HOST. Ctrl-C ends it.
"""


class View(Command):
    """The verb `view`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument(
            "subject", type=Path, metavar="RUN|PLY", help="a run folder or a PLY file"
        )
        parser.add_argument(
            "--port",
            type=int,
            default=PORT,
            metavar="N",
            help=f"the port to try first (default {PORT}); the next free one is taken",
        )
        add_accept_changed_inputs(parser)
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Serve the page until Ctrl-C."""
        from .package import import_viser

        import_viser()  # told before anything is loaded
        from registry.training import one_torch_thread

        with one_torch_thread():
            subject = _subject(arguments)
            from .viewer import Viewer

            viewer = Viewer(subject, arguments.port)
            console().print(f"{subject.name} is at {viewer.url}; Ctrl-C ends it")
            try:
                viewer.serve_until_interrupted()
            finally:
                viewer.close()
        return 0


def _subject(arguments: argparse.Namespace) -> Subject:
    if arguments.subject.suffix.lower() == ".ply":
        from core_rasterizer import open_device

        from .subject import of_file

        return of_file(arguments.subject, open_device(arguments.device))
    from registry.session import open_run

    run = open_run(
        arguments.subject,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )
    from .subject import of_run

    return of_run(run)


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("view", View)
