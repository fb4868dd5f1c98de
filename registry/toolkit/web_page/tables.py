"""Tables of facts and of scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any


@dataclass(frozen=True)
class Cell:
    """A cell of a table of scores.

    Args:
        text: Plain text.
        strong: If True, bold.
    """

    text: str
    strong: bool = False


def facts_table(facts: Mapping[str, Any]) -> str:
    """Return a table of names and JSON values; nested mappings become `outer.inner`."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(_plain(value))}</td></tr>"
        for name, value in _flat(facts)
    )
    return f'<div class="scroll"><table class="facts">{rows}</table></div>' if rows else ""


def score_table(
    head: Sequence[str], rows: Sequence[Sequence[Cell]], *, names: int = 1, caption: str = ""
) -> str:
    """Return a table of numbers.

    Args:
        head: Header of each column.
        rows: Rows as long as `head`.
        names: Number of columns on the left that hold names, not numbers.
        caption: Text above the table; may be empty.
    """
    titles = _cells("th", [Cell(text) for text in head], names)
    body = "".join(f"<tr>{_cells('td', row, names)}</tr>" for row in rows)
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    table = f"{above}<thead><tr>{titles}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="scores">{table}</table></div>'


def _cells(tag: str, cells: Sequence[Cell], names: int) -> str:
    parts = []
    for column, cell in enumerate(cells):
        kinds = ["name"] * (column < names) + ["strong"] * cell.strong
        attribute = f' class="{" ".join(kinds)}"' if kinds else ""
        parts.append(f"<{tag}{attribute}>{escape(cell.text)}</{tag}>")
    return "".join(parts)


def _plain(value: Any) -> str:
    """Format a JSON value."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "\u2013"}[value]
    if isinstance(value, int):
        return f"{value:,}" if abs(value) >= 10_000 else str(value)
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_plain(child) for child in value)
    return str(value)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
