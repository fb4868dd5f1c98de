"""`stereogs bench`: pipelines on scenes, at several lengths and with several seeds, as one table."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..output import Verbs, add_verb
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


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(
        verbs, "bench", "train several pipelines on several scenes; one table", _EPILOG
    )
    parser.add_argument("file", type=Path, metavar="MATRIX", help="a matrix file")
    add_arguments(parser, "runs/bench-<file>")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Train what is missing, then write and print the table; 130 after Ctrl-C."""
    from ...ablation.planning.matrix import plan_of, read_matrix
    from ...plugins.discovery import Plugins

    matrix, plugins = read_matrix(arguments.file), Plugins()
    return carry_out(arguments, plan_of(matrix, plugins), matrix.runner, plugins)
