"""Text on the terminal, wrapped to its width and without control characters, and the parser of commands."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterable, Sequence
from itertools import groupby
from textwrap import wrap
from typing import Any, NoReturn

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from core_rasterizer.errors import ExplainedError

from .suggestions import did_you_mean
from .visible_text import visible

WIDTH = "COLUMNS"
"""Environment variable: the number of characters per line, even without a terminal."""


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


class CommandParser(argparse.ArgumentParser):
    """An `ArgumentParser` that raises an `ExplainedError` instead of printing its usage and exiting."""

    def error(self, message: str) -> NoReturn:
        """Raise the error, with the command that prints the help."""
        raise ExplainedError(
            message, where=self.prog, fix=f"`{self.prog} --help` shows what it takes, and examples"
        )

    # Its stub is overloaded by the namespace's type, which does not matter here.
    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> Any:
        """Parse; the verb's own parser refuses unknown options, since it can suggest the nearest one."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = [name for action in self._actions for name in action.option_strings]
            first = unknown[0].partition("=")[0]
            self.error(f"{first!r} is not understood{did_you_mean(first, options)}")
        return parsed, unknown


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Wraps descriptions and epilogs: prose by paragraphs, examples, which are indented, line by line."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines: list[str] = []
        for is_prose, block in groupby(text.splitlines(), lambda line: line[:1] not in ("", " ")):
            if is_prose:
                lines += wrapped(" ".join(block), width)
            else:
                lines += (part for line in block for part in wrapped(line, width) or [""])
        return "\n".join(indent + line for line in lines)
