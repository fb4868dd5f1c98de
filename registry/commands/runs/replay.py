"""`stereogs replay`: repeat an iteration that failed."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..output import Verbs, add_accept_changed_inputs, add_device, add_verb, console

_EPILOG = """\
examples:
  stereogs replay runs/3dgs-fern/failures/iteration-0000021
  STEREOGS_TRACE=1 stereogs replay runs/3dgs-fern/failures/iteration-0000021

A run that fails in an iteration keeps the moment before it. This repeats that iteration: it ends in the
same error, or, once what was wrong is mended, says so.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "replay", "repeat an iteration that failed", _EPILOG)
    parser.add_argument(
        "failure", type=Path, metavar="FAILURE", help="a folder in RUN/failures, or a file in it"
    )
    add_accept_changed_inputs(parser)
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Repeat it; 0 if it goes through now."""
    from core_rasterizer import open_device

    from ...plugins.discovery import Plugins
    from ...runs.replay import replay
    from ...training.threads import one_torch_thread

    with one_torch_thread():
        failure = replay(
            arguments.failure,
            plugins=Plugins(),
            device=open_device(arguments.device),
            accept_changed_inputs=arguments.accept_changed_inputs,
        )
    console().print(
        f"iteration {failure.iteration} goes through; when it was kept, it failed: {failure.what}"
    )
    return 0
