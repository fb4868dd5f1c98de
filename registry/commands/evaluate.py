"""Score a run's views again, from its checkpoint."""

from __future__ import annotations

import argparse

from ..contract.command import Command
from .output import add_run, console, open_given
from .train import print_failures

_EPILOG = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. For a finished run it also renews exports and reports. A run that was
stopped is scored at its checkpoint.
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
        from ..runs.results import RENDERS
        from .run_table import results_table

        results = run.renew()
        output.print(results_table(results), soft_wrap=False)
        if run.scene.test:
            output.print(f"pictures  {run.folder_or_refuse().path / RENDERS}")
        return print_failures(results["failures"], arguments.run_folder)
