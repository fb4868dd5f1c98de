"""`stereogs view`: a run or a PLY file in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .output import Verbs, add_accept_changed_inputs, add_device, add_verb, console

if TYPE_CHECKING:
    from ..viewing.subject import Subject

PORT = 8080

_EPILOG = """\
examples:
  stereogs view runs/3dgs-fern
  stereogs view scene.ply --port 9000

It needs the extra `viewer` (pip install 'stereogs-plugins[viewer]'). The page is for this machine alone;
through ssh: ssh -L 8080:localhost:8080 HOST. Ctrl-C ends it.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "view", "look at a run or a PLY file in the browser", _EPILOG)
    parser.add_argument("subject", type=Path, metavar="RUN|PLY", help="a run folder or a PLY file")
    parser.add_argument(
        "--port",
        type=int,
        default=PORT,
        metavar="N",
        help=f"the port to try first (default {PORT}); the next free one is taken",
    )
    add_accept_changed_inputs(parser)
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    from ..viewing.package import import_viser

    import_viser()  # told before anything is loaded
    from ..training.threads import one_torch_thread

    with one_torch_thread():
        subject = _subject(arguments)
        from ..viewing.viewer import Viewer

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

        from ..viewing.subject import of_file

        return of_file(arguments.subject, open_device(arguments.device))
    from ..session import open_run

    run = open_run(
        arguments.subject,
        device=arguments.device,
        accept_changed_inputs=arguments.accept_changed_inputs,
    )
    from ..viewing.subject import of_run

    return of_run(run)
