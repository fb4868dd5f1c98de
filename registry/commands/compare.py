"""`stereogs compare`: finished runs in one table, beside published numbers if asked for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import RunError
from ..suggestions import did_you_mean, listing
from .output import Verbs, add_verb, console

if TYPE_CHECKING:
    from ..comparing.comparison import FinishedRun
    from ..comparing.paper_tables import PaperTables

_EPILOG = """\
examples:
  stereogs compare runs/3dgs-fern runs/stereogs-fern
  stereogs compare runs/* --paper llff-3
  stereogs compare --paper dtu-3

Runs of different protocols, of one scene prepared in two ways, or with metrics measured differently are
refused, with the reason. Where the runs cover several scenes, each method's mean follows, if all methods
were run on the same scenes. --paper adds what the StereoGS paper reports for a protocol.
"""

WIDEST = 500
"""Columns of text that a table may take."""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "compare", "set finished runs side by side", _EPILOG)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="a run folder")
    parser.add_argument(
        "--paper", metavar="PROTOCOL", help="add the published numbers, for example llff-3"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compare and print."""
    if not arguments.runs and arguments.paper is None:
        raise RunError(
            "there is nothing to compare",
            where="the command line",
            fix="give run folders, or --paper llff-3 for the published numbers alone",
        )
    from ..comparing.comparability import check_comparable
    from ..comparing.comparison import read_run
    from ..comparing.paper_tables import paper_tables
    from ..comparing.table import comparison_table

    runs = [read_run(path) for path in arguments.runs]
    check_comparable(runs)
    tables = paper_tables() if arguments.paper is not None else None
    if tables is not None:
        _check_paper(arguments.paper, runs, tables)
    output = console()
    # As wide as its numbers need: a cut number would be worse than a line that the terminal folds.
    output.width = WIDEST
    output.print(comparison_table(runs, arguments.paper, tables), soft_wrap=False)
    return 0


def _check_paper(paper: str, runs: Sequence[FinishedRun], tables: PaperTables) -> None:
    if paper not in tables.results:
        raise RunError(
            f"the paper reports nothing for {paper!r}{did_you_mean(paper, tables.results)}",
            where="--paper",
            fix=f"protocols: {listing(tables.results)}",
        )
    for finished in runs:
        if finished.protocol != paper:
            follows = finished.protocol or "no protocol"
            raise RunError(
                f"the run cannot be set beside the published numbers for {paper}: it follows {follows}",
                where=str(finished.folder),
                fix=f"train it with --set protocol={paper}",
            )
