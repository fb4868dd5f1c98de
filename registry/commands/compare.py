"""`stereogs compare`: finished runs in one table, beside published numbers if asked for."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.table import Table

from ..comparing.comparability import check_comparable, check_present
from ..comparing.comparison import FinishedRun, MethodMean, method_means, metric_names, read_run
from ..comparing.paper_tables import PaperTables, paper_tables
from ..errors import RunError
from ..pipeline.protocols import load_protocol, protocol_names
from ..runs.results import ABSENT
from ..suggestions import did_you_mean, listing
from .output import Verbs, add_verb, console

_EPILOG = """\
examples:
  stereogs compare runs/3dgs-fern runs/stereogs-fern
  stereogs compare runs/* --paper stereogs
  stereogs compare --paper stereogs --protocol dtu-3

Runs of different protocols, of one scene prepared in two ways, or with metrics measured differently are
refused, with the reason. Where the runs cover several scenes, each method's mean follows, if all methods
were run on the same scenes. --paper adds what a paper reports for the protocol that the runs follow.
"""

WIDEST = 500
"""Columns of text that a table may take."""
_COSTS = {"gaussians": "Gaussians", "seconds": "seconds", "peak_memory_mb": "memory MB"}


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "compare", "set finished runs side by side", _EPILOG)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="a run folder")
    parser.add_argument(
        "--paper", metavar="NAME", help="add the numbers that a paper reports, for example stereogs"
    )
    parser.add_argument(
        "--protocol", metavar="NAME", help="which of them (default: the one that the runs follow)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compare and print."""
    if not arguments.runs and arguments.paper is None:
        raise RunError(
            "there is nothing to compare",
            where="the command line",
            fix="give run folders, or --paper NAME --protocol NAME for published numbers alone",
        )
    runs = [read_run(path) for path in arguments.runs]
    check_comparable(runs)
    published = None
    if arguments.paper is not None:
        published = _published(arguments.paper, arguments.protocol, runs)
    output = console()
    # As wide as its numbers need: a cut number would be worse than a line that the terminal folds.
    output.width = WIDEST
    output.print(comparison_table(runs, published), soft_wrap=False)
    return 0


@dataclass(frozen=True)
class Published:
    """What a paper reports for one protocol."""

    tables: PaperTables
    protocol: str


def comparison_table(runs: Sequence[FinishedRun], published: Published | None) -> Table:
    """Runs, their means over scenes, and published rows."""
    metrics = metric_names(runs) or list(published.tables.metrics if published else ())
    table = Table(
        title=_title(runs, published), box=box.SIMPLE, title_justify="left", caption_justify="left"
    )
    for column in ("run", "method", "scene"):
        table.add_column(column, no_wrap=True)
    for column in (*metrics, *_COSTS.values()):
        table.add_column(column, justify="right", no_wrap=True)
    for finished in runs:
        numbers = {**finished.scores, **{key: finished.results.get(key) for key in _COSTS}}
        label = (finished.folder.name, finished.pipeline, finished.scene)
        table.add_row(*label, *_cells(numbers, metrics))
    captions = _add_means(table, method_means(runs), metrics)
    if published is not None:
        captions += _add_published(table, published, metrics, runs)
    table.caption = "\n".join(captions) or None
    return table


def _title(runs: Sequence[FinishedRun], published: Published | None) -> str:
    protocol = runs[0].protocol if runs else published.protocol if published else None
    return f"protocol {protocol}" if protocol else "no protocol"


def _add_means(table: Table, means: Sequence[MethodMean], metrics: Sequence[str]) -> list[str]:
    """Rows of means if there are several scenes; returns remarks for below the table."""
    covered = {mean.scenes for mean in means}
    if max((len(scenes) for scenes in covered), default=0) < 2:
        return []
    if len(covered) > 1:
        parts = "; ".join(f"{mean.method}: {', '.join(mean.scenes)}" for mean in means)
        return [f"No means: the methods were run on different scenes ({parts})."]
    table.add_section()
    for mean in means:
        scenes = f"mean of {len(mean.scenes)}"
        table.add_row("", mean.method, scenes, *_cells(mean.numbers, metrics))
    return []


def _add_published(
    table: Table, published: Published, metrics: Sequence[str], runs: Sequence[FinishedRun]
) -> list[str]:
    """The published rows; returns remarks for below the table."""
    tables, protocol = published.tables, published.protocol
    scenes = load_protocol(protocol).scenes
    costs = tables.overhead.get(protocol, {})
    table.add_section()
    for method, row in tables.results[protocol].items():
        numbers: dict[str, float | None] = {}
        if row is not None:
            numbers.update(zip(tables.metrics, row, strict=True))
        if method in costs:
            numbers["gaussians"] = costs[method].gaussians
        label = ("published", tables.methods[method], f"mean of {len(scenes)}")
        table.add_row(*label, *_cells(numbers, metrics))
    remarks = [f"Published: {tables.source}; means over {', '.join(scenes)}.", *tables.notes]
    if protocol in tables.protocol_notes:
        remarks.append(tables.protocol_notes[protocol])
    if runs:
        ours = ", ".join(sorted({finished.scene for finished in runs}))
        remarks.append(f"Ours: {ours}. A mean over other scenes is no reproduction.")
    return remarks


def _cells(numbers: Mapping[str, float | None], metrics: Sequence[str]) -> list[str]:
    scores = [numbers.get(name) for name in metrics]
    costs = [numbers.get(name) for name in _COSTS]
    return [
        *(ABSENT if score is None else _score(score) for score in scores),
        *(ABSENT if cost is None else f"{cost:,.0f}" for cost in costs),
    ]


def _score(value: float) -> str:
    """To as many digits as papers print."""
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def _published(paper: str, protocol: str | None, runs: Sequence[FinishedRun]) -> Published:
    """What the paper reports for the protocol that is named, or that the runs follow.

    Raises:
        RunError: the paper or the protocol is not known, or a run does not follow it as it is now.
    """
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
