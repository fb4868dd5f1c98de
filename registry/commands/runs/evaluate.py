"""`stereogs eval`: score a run's checkpoint again."""

from __future__ import annotations

import argparse

from ..output import Verbs, add_run, add_verb, console, open_given
from .train import tell_failures

_EPILOG = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. Of a finished run the exports and reports are renewed too; one that was
stopped is scored where it stands.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "eval", "score a run's views again, from its checkpoint", _EPILOG)
    add_run(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate and print."""
    output = console()
    run = open_given(arguments)
    from ...comparing.run_table import results_table
    from ...runs.results import RENDERS, renew

    results = renew(run)
    output.print(results_table(results), soft_wrap=False)
    if run.scene.test:
        output.print(f"pictures  {run.folder_or_refuse().path / RENDERS}")
    return tell_failures(results, arguments.run_folder)
