"""Set finished runs side by side."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from registry import Command, Register, RunError, hookimpl
from registry.commands import console
from registry.messages import did_you_mean, listing

if TYPE_CHECKING:
    from rich.table import Table

    from .comparing.comparison import FinishedRun
    from .comparing.table import Published

_EPILOG = """\
examples:
  stereogs compare runs/3dgs-fern runs/stereogs-fern
  stereogs compare runs/* --paper stereogs
  stereogs compare runs/* --format latex
  stereogs compare runs/* --format page > comparison.html
  stereogs compare --paper stereogs --protocol dtu-3

Runs of different protocols, of one scene prepared in two ways, or with metrics measured
differently come in tables of their own, with the reason. Runs of one pipeline are told apart by the
settings that differ. Where the runs cover several scenes, each method's mean follows, if all methods
were run on the same scenes. --paper adds what a paper reports for the protocol that the runs follow.
"""

FORMATS = ("table", "csv", "markdown", "latex", "page")
WIDEST = 500
"""Columns of text that a table may take where there is no terminal."""


class Compare(Command):
    """The verb `compare`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="a run folder")
        parser.add_argument(
            "--paper",
            metavar="NAME",
            help="add the numbers that a paper reports, for example stereogs",
        )
        parser.add_argument(
            "--protocol",
            metavar="NAME",
            help="which of them (default: the one that the runs follow)",
        )
        parser.add_argument(
            "--format",
            choices=FORMATS,
            default=FORMATS[0],
            help="csv: the runs alone, every digit; markdown, latex: as the table; page: HTML with the "
            "renders beside the photographs (default: table)",
        )

    def run(self, arguments: argparse.Namespace) -> int:
        """Compare and print."""
        if not arguments.runs and arguments.paper is None:
            raise RunError(
                "there is nothing to compare",
                where="the command line",
                fix="give run folders, or --paper NAME --protocol NAME for published numbers alone",
            )
        from .comparing.comparability import check_comparable, comparable_groups
        from .comparing.comparison import read_run
        from .comparing.formats import as_csv
        from .comparing.table import comparison_table

        runs = [read_run(path) for path in arguments.runs]
        if arguments.paper is not None:
            check_comparable(runs)
            published = _published(arguments.paper, arguments.protocol, runs)
            tables = [comparison_table(runs, published)]
        elif arguments.format == "csv":
            print(as_csv(runs), end="")
            return 0
        else:
            groups = comparable_groups(runs)
            tables = [comparison_table(members, None, reason) for members, reason in groups]
        if arguments.format == "page":
            from .comparing.page import as_page

            print(as_page(runs, tables), end="")
            return 0
        for table in tables:
            _print(table, arguments.format)
        return 0


def _print(table: Table, format_name: str) -> None:
    from .comparing.formats import as_latex, as_markdown
    from .comparing.table import narrowest

    if format_name == "csv":
        raise RunError(
            "CSV is written of runs alone",
            where="--format csv",
            fix="leave --paper out, or choose another format",
        )
    if format_name != "table":
        print(as_markdown(table) if format_name == "markdown" else as_latex(table))
        return
    output = console()
    # As wide as its numbers need: a cut number would be worse than a line that the terminal folds.
    output.width = max(output.width, narrowest(table)) if output.has_width else WIDEST
    output.print(table, soft_wrap=False)


def _published(paper: str, protocol: str | None, runs: Sequence[FinishedRun]) -> Published:
    """What the paper reports for the protocol that is named, or that the runs follow.

    Raises:
        RunError: the paper or the protocol is not known, or a run does not follow it as it is now.
    """
    from registry.pipeline import protocol_names

    from .comparing.comparability import check_present
    from .comparing.paper_tables import paper_tables
    from .comparing.table import Published

    tables = paper_tables(paper)
    known = [name for name in tables.results if name in protocol_names()]
    if protocol is None and runs and runs[0].results["protocol"] is not None:
        protocol = str(runs[0].results["protocol"]["name"])
    if protocol is None:
        raise RunError(
            "it is not said which of the paper's numbers are wanted"
            + (": the runs follow no protocol" if runs else ""),
            where="--paper",
            fix=f"add --protocol; the paper reports {listing(known)}",
        )
    if protocol not in known:
        raise RunError(
            f"the paper reports nothing for {protocol!r}{did_you_mean(protocol, known)}",
            where="--paper",
            fix=f"protocols: {listing(known)}",
        )
    for finished in runs:
        if finished.protocol != protocol:
            follows = finished.protocol or "no protocol"
            raise RunError(
                f"the run cannot be set beside the published numbers for {protocol}: it follows "
                f"{follows}",
                where=str(finished.folder),
                fix=f"train it with --set protocol={protocol}",
            )
        check_present(finished)
    return Published(tables, protocol)


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("compare", Compare)
