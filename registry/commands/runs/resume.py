"""`stereogs resume`: go on with a run from its newest checkpoint."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..output import (
    Verbs,
    add_accept_changed_inputs,
    add_device,
    add_verb,
    add_watching,
    console,
    watching,
)
from .live_page import live_page
from .train import conclude

_EPILOG = """\
examples:
  stereogs resume runs/3dgs-fern

Goes on after the newest checkpoint that is whole, to the same result as if the run had never stopped: after
Ctrl-C, a kill, a crash or a full disk. A run that had reached its end is scored and exported again.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "resume", "go on with a run that was stopped", _EPILOG)
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
    add_accept_changed_inputs(parser)
    add_device(parser)
    add_watching(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Train to the end; exit status as for `train`."""
    from ...session import resume

    output = console()
    with live_page(arguments.view, output) as page:
        run = resume(
            arguments.run_folder,
            progress=output,
            device=arguments.device,
            accept_changed_inputs=arguments.accept_changed_inputs,
            **watching(arguments),
            **page,
        )
        return conclude(run, output)
