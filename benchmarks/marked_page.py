"""Pages of which a part is measured: what stands between two marks is rewritten, the rest is people's."""

from __future__ import annotations

from pathlib import Path

from registry import RunError
from registry.system import write_text


def rewrite(page: Path, begin: str, end: str, text: str) -> None:
    """Put the text between the marks of a page.

    Raises:
        RunError: the page is missing or lacks the marks.
    """
    before, found, rest = (page.read_text("utf-8") if page.is_file() else "").partition(begin)
    _, ended, after = rest.partition(end)
    if not found or not ended:
        raise RunError(
            "the page has lost the marks around its measured part",
            where=str(page),
            fix=f"put the lines back:\n{begin}\n{end}",
        )
    write_text(page, f"{before}{begin}\n\n{text}\n{end}{after}")
