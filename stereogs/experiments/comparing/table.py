"""Tables of runs, means over scenes and published rows, and their output as CSV, Markdown, LaTeX and HTML."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich import box
from rich.cells import cell_len
from rich.table import Table

from registry.pipeline.protocols import load_protocol
from registry.runs.results import RENDERS
from registry.toolkit.web_page import Cell, note, page, score_table, section

from ...command_line.output import ABSENT
from ..showing.view_gallery import RenderedRun, view_gallery
from .comparison import COSTS, FinishedRun, MethodMean, method_means, metric_names
from .labels import labels
from .paper_tables import PaperTables

_LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "–": "--", "\\": r"\textbackslash{}"}  # noqa: RUF001
_FOLDED = 8
"""Smallest number of characters per line of a folded name."""
_BETWEEN = 2
"""Characters between two columns."""


@dataclass(frozen=True)
class Published:
    """The numbers of a paper for one protocol."""

    tables: PaperTables
    protocol: str


def comparison_table(
    runs: Sequence[FinishedRun], published: Published | None, reason: str = ""
) -> Table:
    """Return a table of runs, means over scenes, and published rows.

    `reason` says why the runs are not in the first table.
    """
    metrics = metric_names(runs) or list(published.tables.metrics if published else ())
    table = Table(
        title=_title(runs, published),
        box=box.SIMPLE,
        title_justify="left",
        caption_justify="left",
        pad_edge=False,
        collapse_padding=True,
    )
    for column in ("run", "method", "scene"):
        table.add_column(column, overflow="fold")
    for column in (*metrics, *COSTS.values()):
        table.add_column(column, justify="right", no_wrap=True)
    for run, method in zip(runs, labels(runs), strict=True):
        table.add_row(run.folder.name, method, run.scene, *_cells(run.numbers, metrics))
    captions = _add_means(table, method_means(runs), metrics)
    if reason:
        captions.append(f"Separate table because {reason}.")
    if published is not None:
        captions += _add_published(table, published, metrics, runs)
    table.caption = "\n".join(captions) or None
    return table


def smallest_width(table: Table) -> int:
    """Return the characters that a table needs if names are folded and numbers are not."""
    needed = 0
    for column in table.columns:
        whole = max(cell_len(str(text)) for text in (column.header, *column.cells))
        needed += _BETWEEN + (whole if column.no_wrap else min(whole, _FOLDED))
    return needed


def _title(runs: Sequence[FinishedRun], published: Published | None) -> str:
    protocol = runs[0].protocol if runs else published.protocol if published else None
    return f"protocol {protocol}" if protocol else "no protocol"


def _add_means(table: Table, means: Sequence[MethodMean], metrics: Sequence[str]) -> list[str]:
    """Add rows of means if there are several scenes; return notes."""
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
    """Add the published rows; return notes."""
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
    notes = [f"Published: {tables.source}; means over {', '.join(scenes)}.", *tables.notes]
    if protocol in tables.protocol_notes:
        notes.append(tables.protocol_notes[protocol])
    if runs:
        ours = ", ".join(sorted({run.scene for run in runs}))
        notes.append(f"Ours: {ours}. Means over different scenes are not comparable.")
    return notes


def _cells(numbers: Mapping[str, float | None], metrics: Sequence[str]) -> list[str]:
    scores = [numbers.get(name) for name in metrics]
    costs = [numbers.get(name) for name in COSTS]
    return [
        *(ABSENT if score is None else _score(score) for score in scores),
        *(ABSENT if cost is None else f"{cost:,.0f}" for cost in costs),
    ]


def _score(value: float) -> str:
    """Format with as many digits as papers use."""
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def as_csv(runs: Sequence[FinishedRun]) -> str:
    """Return a line per run, with the numbers of results.json; missing ones are empty."""
    metrics = metric_names(runs)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["run", "method", "protocol", "scene", *metrics, *COSTS])
    for run, label in zip(runs, labels(runs), strict=True):
        numbers = [*map(run.scores.get, metrics), *map(run.results.get, COSTS)]
        writer.writerow([run.folder, label, run.protocol, run.scene, *numbers])
    return text.getvalue()


def as_markdown(table: Table) -> str:
    """Return the title, the table and the notes."""
    header, *rows = cells(table)
    marks = ["---:" if column.justify == "right" else "---" for column in table.columns]
    lines = [_row(line) for line in (header, marks, *rows)]
    parts = (str(table.title), "\n".join(lines), str(table.caption or ""))
    return "\n\n".join(part for part in parts if part) + "\n"


def _row(cells: Sequence[str]) -> str:
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"


def as_latex(table: Table) -> str:
    """Return a `tabular` that uses the package booktabs, with title and notes as comments."""
    header, *rows = (
        ["".join(_LATEX.get(sign, sign) for sign in cell) for cell in row] for row in cells(table)
    )
    columns = "".join("r" if column.justify == "right" else "l" for column in table.columns)
    comments = [
        f"% {line}" for line in f"{table.title}\n{table.caption or ''}".strip().splitlines()
    ]
    lines = [
        *comments,
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        rf"{' & '.join(header)} \\",
        r"\midrule",
        *(rf"{' & '.join(row)} \\" for row in rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def cells(table: Table) -> list[list[str]]:
    """Return the header and the rows."""
    headers = [str(column.header) for column in table.columns]
    return [headers, *map(list, zip(*([*map(str, c.cells)] for c in table.columns), strict=True))]


def as_page(runs: Sequence[FinishedRun], tables: Sequence[Table]) -> str:
    """Return an HTML page without other files: the tables, and the renders of each test view."""
    contents = [_html_table(table) for table in tables]
    for scene in dict.fromkeys(run.scene for run in runs):
        contents.append(section(scene, _gallery([run for run in runs if run.scene == scene])))
    return page("Comparison of runs", contents)


def _html_table(table: Table) -> str:
    header, *rows = cells(table)
    names = sum(column.justify != "right" for column in table.columns)
    body = [[Cell(text) for text in row] for row in rows]
    notes = "".join(map(note, str(table.caption or "").splitlines()))
    return score_table(header, body, names=names, caption=str(table.title)) + notes


def _gallery(runs: Sequence[FinishedRun]) -> str:
    return view_gallery(
        [
            RenderedRun(
                f"{run.folder.name}: {label}",
                run.folder / RENDERS,
                run.results.get("views", {}).get("test", {}),
            )
            for run, label in zip(runs, labels(runs), strict=True)
        ]
    )
