"""Parser of the command line: explained errors, and help that fits the terminal."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import groupby
from typing import Any, NoReturn

from core_rasterizer.errors import ExplainedError

from .suggestions import did_you_mean
from .terminal import wrapped


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
        for is_prose, block in groupby(text.splitlines(), _is_prose):
            if is_prose:
                lines += wrapped(" ".join(block), width)
            else:
                lines += (part for line in block for part in wrapped(line, width) or [""])
        return "\n".join(indent + line for line in lines)


def _is_prose(line: str) -> bool:
    return bool(line.strip()) and not line.startswith(" ")
