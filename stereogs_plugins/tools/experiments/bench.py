"""Train several pipelines on several scenes; one table."""

from __future__ import annotations

import argparse
from pathlib import Path

from registry import Command, Register, hookimpl

from .carrying_out import add_arguments, carry_out

_EPILOG = """\
examples:
  stereogs bench matrix.yaml
  stereogs bench matrix.yaml --runner ray

A matrix file says what is trained on what:

  pipelines: [weightfree_fast, 3dgs_fast, ./mine.yaml]
  scenes: [llff_fern, llff_flower]
  iterations: [100, 400]          without it: as each pipeline says
  seeds: 3
  runner: {use: ray}              without it: processes of this machine

Runs that are finished are found by their pipeline and not trained again: the same command goes on
where it was stopped. It writes bench.txt, bench.csv and index.html.
"""


class Bench(Command):
    """The verb `bench`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("file", type=Path, metavar="MATRIX", help="a matrix file")
        add_arguments(parser, "runs/bench-<file>")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train what is missing, then write and print the table; 130 after Ctrl-C."""
        from registry.plugins import Plugins

        from .planning.matrix import plan_of, read_matrix

        matrix, plugins = read_matrix(arguments.file), Plugins()
        return carry_out(arguments, plan_of(matrix, plugins), matrix.runner, plugins)


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("bench", Bench)
