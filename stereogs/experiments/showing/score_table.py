"""A table and its output as text, Markdown, LaTeX and HTML; for all verbs and for `benchmarks/`."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from rich import box
from rich.cells import cell_len
from rich.table import Table

from registry.toolkit.web_page import Cell, note, score_table

_LATEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    **{sign: f"${sign}$" for sign in "<>"},
    "–": "--",  # noqa: RUF001
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "✓": r"$\checkmark$",
    "✗": r"$\times$",
}
_FOLDED = 8
"""Smallest number of characters per line of a folded name."""
_BETWEEN = 2
"""Characters between two columns."""


@dataclass(frozen=True)
class ScoreTable:
    """A table of scores.

    Args:
        title: of the table.
        head: a heading per column.
        names: number of columns on the left with names; the others have numbers.
        rows: cells; the best number of a column is strong.
        notes: lines below the table.
        sections: rows with a line above.
    """

    title: str
    head: Sequence[str]
    names: int
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()
    sections: Collection[int] = ()

    @property
    def texts(self) -> list[list[str]]:
        """The header and the rows as texts."""
        return [[*self.head], *([cell.text for cell in row] for row in self.rows)]

    @property
    def smallest_width(self) -> int:
        """The characters that it needs if names are folded and numbers are not."""
        whole = [max(map(cell_len, column)) for column in zip(*self.texts, strict=True)]
        folded = [min(width, _FOLDED) for width in whole[: self.names]]
        return sum(_BETWEEN + width for width in (*folded, *whole[self.names :]))

    def drawn(self) -> Table:
        """Return the table for a terminal or a text file."""
        table = Table(
            title=self.title,
            caption="\n".join(self.notes) or None,
            box=box.SIMPLE_HEAD,
            title_justify="left",
            caption_justify="left",
            pad_edge=False,
            collapse_padding=True,
        )
        header, *rows = self.texts
        for index, heading in enumerate(header):
            named = index < self.names
            overflow, justify = ("fold", "left") if named else ("ellipsis", "right")
            table.add_column(heading, justify=justify, overflow=overflow, no_wrap=not named)  # type: ignore[arg-type]
        for index, row in enumerate(rows):
            if index in self.sections:
                table.add_section()
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        """Return the title, the table and the notes in Markdown."""
        header, *rows = self.texts
        parts = (self.title, markdown(header, rows, self.names), "\n".join(self.notes))
        return "\n\n".join(part.rstrip("\n") for part in parts if part) + "\n"

    def latex(self) -> str:
        """Return a `tabular`, with title and notes as comments and the best numbers in bold.

        It needs the package booktabs, and for ticks amssymb.
        """
        header, *rows = (
            " & ".join(_in_latex(cell) for cell in row) + r" \\"
            for row in [[*map(Cell, self.head)], *self.rows]
        )
        columns = "l" * self.names + "r" * (len(self.head) - self.names)
        comments = [f"% {line}" for text in (self.title, *self.notes) for line in text.splitlines()]
        lines = [
            *comments,
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            header,
            *(
                line
                for index, row in enumerate(rows)
                for line in ([r"\midrule", row] if index in {0, *self.sections} else [row])
            ),
            r"\bottomrule",
            r"\end{tabular}",
        ]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return the table and its notes for a page."""
        table = score_table(self.head, self.rows, names=self.names, caption=self.title)
        return table + "".join(map(note, self.notes))


def _in_latex(cell: Cell) -> str:
    text = "".join(_LATEX.get(sign, sign) for sign in cell.text)
    return rf"\textbf{{{text}}}" if cell.strong else text


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], names: int = 1) -> str:
    """Return a table in Markdown; `names` columns are aligned to the left, the others to the right."""
    marks = ["---"] * names + ["---:"] * (len(head) - names)
    escaped = ([cell.replace("|", r"\|") for cell in line] for line in (head, marks, *rows))
    return "".join(f"| {' | '.join(line)} |\n" for line in escaped)


def csv_text(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return CSV."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return file.getvalue()
