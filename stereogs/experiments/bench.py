"""Train several pipelines on several scenes; write one table."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..command_line.command import Command
from .run_plan import add_arguments, run_plan

_EPILOG = """\
examples:
  stereogs bench matrix.yaml
  stereogs bench matrix.yaml --runner ray

A matrix file lists what to train:

  pipelines: [weightfree_fast, 3dgs_fast, ./mine.yaml]
  scenes: [llff_fern, llff_flower]
  iterations: [100, 400]          default: the length of each pipeline
  seeds: 3
  runner: {use: ray}              default: processes on this machine

Finished runs are recognized by their pipeline and not trained again, so the same command continues an
interrupted bench. Writes bench.txt, bench.tex, bench.csv,
bench_means.csv and index.html.
"""


class Bench(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("file", type=Path, metavar="MATRIX", help="a matrix file")
        add_arguments(parser, "runs/bench-<file>")

    def run(self, arguments: argparse.Namespace) -> int:
        from registry.discovery import Plugins

        from .planning.matrix import plan_of, read_matrix

        matrix, plugins = read_matrix(arguments.file), Plugins()
        return run_plan(arguments, plan_of(matrix, plugins), matrix.runner, plugins)
