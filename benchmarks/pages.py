"""Markdown of benchmarks: tables, marked parts of pages in `docs`, files in `benchmarks/tables`."""

from __future__ import annotations

from pathlib import Path

from registry import RunError
from registry.system.files import write_text

DOCS = Path(__file__).parent.parent / "docs"
TABLES = Path(__file__).parent / "tables"


def marks(target: str) -> tuple[str, str]:
    """Return the lines around the part of a page that a target of the Makefile writes."""
    return (
        f"<!-- measured: `make {target}` rewrites the text from here to the end mark -->",
        f"<!-- measured: end of `make {target}` -->",
    )


def rewrite(page: Path, marks: tuple[str, str], text: str) -> None:
    """Replace the text between two marks of a page; keep the rest.

    Raises:
        RunError: the page is missing or lacks the marks.
    """
    begin, end = marks
    before, found, rest = (page.read_text("utf-8") if page.is_file() else "").partition(begin)
    _, ended, after = rest.partition(end)
    if not found or not ended:
        raise RunError(
            "the page lacks the marks around its measured part",
            where=str(page),
            fix=f"put the lines back:\n{begin}\n{end}",
        )
    write_text(page, f"{before}{begin}\n\n{text}\n{end}{after}")


def write_tables(name: str, title: str, target: str, text: str) -> Path:
    """Write the file of all tables of a benchmark; return its path."""
    TABLES.mkdir(exist_ok=True)
    path = TABLES / f"{name}.md"
    write_text(path, f"# {title}\n\n<!-- Written by `make {target}`. Do not edit. -->\n\n{text}")
    return path
