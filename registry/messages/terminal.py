"""What reaches the terminal is text: names from outside cannot move its cursor or rename its window."""

from __future__ import annotations

import logging
import unicodedata
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

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


class PlainConsole(Console):
    """A console whose styles are its own: no text that it is given is a command to the terminal."""

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
    """Log lines made `visible`."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        return visible(super().format(record))
