"""Score a run's views again, from its checkpoint."""

from __future__ import annotations

import argparse

from registry.toolkit.progress.display import showing

from ..command_line.arguments import add_accept_changed, add_run, open_given
from ..command_line.command import Command
from ..command_line.output import console, print_failures, results_table

_EPILOG = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. For a finished run it also renews exports and reports. A run that was
stopped is scored at its checkpoint.
"""


class Eval(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add_run(parser)
        add_accept_changed(parser, "plugins")

    def run(self, arguments: argparse.Namespace) -> int:
        """Evaluate and print; return 1 if a metric, an exporter or a report failed."""
        output, accept = console(), arguments.accept_changed_plugins
        with showing(output):
            run = open_given(arguments)
            from registry.runs.outputs import renew
            from registry.runs.results import RENDERS

            folder = run.folder_or_refuse()
            results = renew(run, folder, accept_changed_plugins=accept)

        output.print(results_table(results), soft_wrap=False)
        if run.scene.test:
            output.print(f"pictures  {folder.path / RENDERS}")
        return print_failures(results["failures"], folder.shown())
