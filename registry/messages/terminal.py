"""Text on the terminal: wrapped to its width, without control characters."""

from __future__ import annotations

import logging
import os
import re
import sys
import unicodedata
from collections.abc import Iterable
from shutil import get_terminal_size
from textwrap import wrap
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

_INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's categories of control and format characters, lone surrogates and other line breaks."""
WIDTH = "COLUMNS"
"""Environment variable: the number of characters per line, even without a terminal."""


def visible(text: str) -> str:
    """Escape control characters, as in \\x1b, so that names cannot send commands to the terminal.

    Line breaks and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(
        ascii(c)[1:-1] if c not in "\n\t" and unicodedata.category(c) in _INVISIBLE else c
        for c in text
    )


def wrapped(line: str, width: int) -> list[str]:
    """Wrap a line, keeping words and paths whole; return [] if it is empty.

    Further lines are indented to the explanation after two or more spaces, or by two more spaces.
    """
    indented = re.match(r"( +)(?:\S+(?: \S+)*  +(?=\S))?", line)
    further = min(indented.end(), width // 2) if indented else 0
    if indented and indented.end() == len(indented[1]):
        further += 2
    return wrap(
        line,
        width,
        subsequent_indent=" " * further,
        break_long_words=False,
        break_on_hyphens=False,
    )


def fitting(text: str, width: int) -> str:
    """Wrap all lines of a text; longer words and paths stay whole."""
    return "\n".join(part for line in text.split("\n") for part in (wrapped(line, width) or [line]))


class PlainConsole(Console):
    """A console that escapes control characters in text, and wraps it to the terminal's width.

    In a pipe or a file lines stay whole, so that they can be searched.
    """

    @property
    def has_width(self) -> bool:
        """Whether to wrap: there is a terminal, or `COLUMNS` is set."""
        return self.is_terminal or WIDTH in os.environ

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, with wrapped text."""
        if self.has_width:
            objects = tuple(fitting(x, self.width) if isinstance(x, str) else x for x in objects)
        super().print(*objects, **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Yield rich's segments, with control characters in text escaped."""
        for segment in super().render(renderable, options):
            is_text = segment.control is None
            yield Segment(visible(segment.text), segment.style) if is_text else segment


class PlainFormatter(logging.Formatter):
    """Formats log lines as `PlainConsole` prints text."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        text = visible(super().format(record))
        if sys.stderr.isatty() or WIDTH in os.environ:
            return fitting(text, get_terminal_size().columns)
        return text
