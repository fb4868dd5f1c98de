"""A comparison for other programs: CSV with every digit, Markdown and LaTeX as the table shows it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from rich.table import Table

from .comparison import COSTS, FinishedRun, metric_names
from .differences import labels

_LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "–": "--", "\\": r"\textbackslash{}"}  # noqa: RUF001


def as_csv(runs: Sequence[FinishedRun]) -> str:
    """A line for each run, numbers as results.json has them; empty where there is none."""
    metrics = metric_names(runs)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["run", "method", "protocol", "scene", *metrics, *COSTS])
    for run, label in zip(runs, labels(runs), strict=True):
        numbers = [*(run.scores.get(name) for name in metrics), *map(run.results.get, COSTS)]
        writer.writerow([run.folder, label, run.protocol, run.scene, *numbers])
    return text.getvalue()


def as_markdown(table: Table) -> str:
    """The title, the rows, and the remarks below."""
    header, *rows = cells(table)
    marks = ["---:" if column.justify == "right" else "---" for column in table.columns]
    lines = [_row(line) for line in (header, marks, *rows)]
    parts = (str(table.title), "\n".join(lines), str(table.caption or ""))
    return "\n\n".join(part for part in parts if part) + "\n"


def _row(cells: Sequence[str]) -> str:
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"


def as_latex(table: Table) -> str:
    """A `tabular` with the rules of the package booktabs; title and remarks as comments."""
    header, *rows = ([_escaped(cell) for cell in row] for row in cells(table))
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
    """The header and the rows."""
    headers = [str(column.header) for column in table.columns]
    return [headers, *map(list, zip(*([*map(str, c.cells)] for c in table.columns), strict=True))]


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(sign, sign) for sign in text)
