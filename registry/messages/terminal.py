"""What reaches the terminal is text: names from outside cannot move its cursor or rename its window."""

from __future__ import annotations

import logging
import os
import sys
import unicodedata
from collections.abc import Iterable
from shutil import get_terminal_size
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from .help_text import wrapped

_INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's categories of control and format characters, lone surrogates and other line breaks."""


def visible(text: str) -> str:
    """The text with control characters written out, such as \\x1b; line breaks and tabs stay."""
    if text.isprintable():
        return text
    return "".join(
        ascii(c)[1:-1] if c not in "\n\t" and unicodedata.category(c) in _INVISIBLE else c
        for c in text
    )


WIDTH = "COLUMNS"
"""Environment variable: how many characters a line may have, also where no terminal is."""


def fitting(text: str, width: int) -> str:
    """The text in lines of at most so many characters, but for words and paths that are longer."""
    return "\n".join(part for line in text.split("\n") for part in (wrapped(line, width) or [line]))


class PlainConsole(Console):
    """A console whose styles are its own: no text that it is given is a command to the terminal.

    Texts fit a terminal's width. In a pipe or a file lines stay whole, so that they can be searched.
    """

    @property
    def has_width(self) -> bool:
        """Whether lines are to fit: there is a terminal, or `COLUMNS` says how wide it would be."""
        return self.is_terminal or WIDTH in os.environ

    def print(self, *objects: Any, **options: Any) -> None:
        """As rich prints, texts in lines that fit."""
        if self.has_width:
            objects = tuple(fitting(x, self.width) if isinstance(x, str) else x for x in objects)
        super().print(*objects, **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Rich's segments, with the texts among them made `visible`."""
        for segment in super().render(renderable, options):
            if segment.control is None:
                yield Segment(visible(segment.text), segment.style)
            else:
                yield segment


class PlainFormatter(logging.Formatter):
    """Log lines made `visible`, that fit the terminal where one is shown them."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        text = visible(super().format(record))
        if sys.stderr.isatty() or WIDTH in os.environ:
            return fitting(text, get_terminal_size().columns)
        return text
