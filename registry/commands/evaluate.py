"""Score a run's views again, from its checkpoint."""

from __future__ import annotations

import argparse

from ..contract.command import Command
from .output import add_run, console, open_given
from .train import tell_failures

_EPILOG = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. Of a finished run the exports and reports are renewed too; one that was
stopped is scored where it stands.
"""


class Eval(Command):
    """The verb `eval`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Evaluate and print."""
        output = console()
        run = open_given(arguments)
        from ..runs.results import RENDERS, renew
        from .run_table import results_table

        results = renew(run)
        output.print(results_table(results), soft_wrap=False)
        if run.scene.test:
            output.print(f"pictures  {run.folder_or_refuse().path / RENDERS}")
        return tell_failures(results, arguments.run_folder)
