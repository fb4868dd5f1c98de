"""Compare finished runs in tables."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.messages.suggestions import did_you_mean, listing

from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from .comparing.comparison import FinishedRun
    from .comparing.table import Published
    from .showing.score_table import ScoreTable

_EPILOG = """\
examples:
  stereogs compare runs/3dgs-fern runs/stereogs-fern
  stereogs compare runs/* --paper stereogs
  stereogs compare runs/* --format latex
  stereogs compare runs/* --format page > comparison.html
  stereogs compare --paper stereogs --protocol dtu-3

Runs that are not comparable (different protocols, preparations of a scene or settings of metrics) are in
separate tables with the reason. Methods are labelled by what differs between the runs. Runs that differ
only in the seed also have their mean, with its 95 % interval from three seeds on. If all methods were run on
the same scenes, the table ends with their means. --paper adds the numbers of a paper for the protocol of the
runs.
"""

FORMATS = ("table", "csv", "markdown", "latex", "page")
WIDEST = 500
"""Width of a table in characters if the output is not a terminal."""


class Compare(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="a run folder")
        parser.add_argument(
            "--paper", metavar="NAME", help="add the numbers of a paper, for example stereogs"
        )
        parser.add_argument(
            "--protocol",
            metavar="NAME",
            help="the protocol of the paper's numbers (default: that of the runs)",
        )
        parser.add_argument(
            "--format",
            choices=FORMATS,
            default=FORMATS[0],
            help="csv: only the runs, with all digits; markdown, latex: the same text as table; page: HTML "
            "with renders next to the photographs (default: table)",
        )

    def run(self, arguments: argparse.Namespace) -> int:
        if not arguments.runs and arguments.paper is None:
            raise RunError(
                "there is nothing to compare",
                where="the command line",
                fix="give run folders, or --paper NAME --protocol NAME for only published numbers",
            )
        from .comparing.comparability import check_comparable, comparable_groups
        from .comparing.comparison import read_run
        from .comparing.table import as_csv, as_page, comparison_table

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
            print(as_page(runs, tables), end="")
            return 0
        for table in tables:
            _print(table, arguments.format)
        return 0


def _print(table: ScoreTable, format_name: str) -> None:
    if format_name == "csv":
        raise RunError(
            "CSV cannot include published numbers",
            where="--format csv",
            fix="remove --paper, or choose another format",
        )
    if format_name != "table":
        print(table.markdown() if format_name == "markdown" else table.latex())
        return
    output = console()
    # A folded line is better than a truncated number.
    output.width = max(output.width, table.smallest_width) if output.has_width else WIDEST
    output.print(table.drawn(), soft_wrap=False)


def _published(paper: str, protocol: str | None, runs: Sequence[FinishedRun]) -> Published:
    """Return the numbers of a paper for a protocol, by default that of the runs.

    Raises:
        RunError: the paper or the protocol is unknown, or a run follows another protocol or an older version.
    """
    from registry.pipeline.protocols import protocol_names

    from .comparing.comparability import check_protocol_is_current
    from .comparing.paper_tables import paper_tables
    from .comparing.table import Published

    tables = paper_tables(paper)
    known = [name for name in tables.results if name in protocol_names()]
    if protocol is None and runs and runs[0].results["protocol"] is not None:
        protocol = str(runs[0].results["protocol"]["name"])
    if protocol is None:
        raise RunError(
            "--paper needs a protocol" + (": the runs follow none" if runs else ""),
            where="--paper",
            fix=f"add --protocol; the paper reports {listing(known)}",
        )
    if protocol not in known:
        raise RunError(
            f"the paper has no numbers for {protocol!r}{did_you_mean(protocol, known)}",
            where="--paper",
            fix=f"protocols: {listing(known)}",
        )
    for run in runs:
        if run.protocol != protocol:
            raise RunError(
                f"the run is not comparable with published numbers for {protocol}: it follows "
                f"{run.protocol or 'no protocol'}",
                where=str(run.folder),
                fix=f"train it with --set protocol={protocol}",
            )
        check_protocol_is_current(run)
    return Published(tables, protocol)
