"""A parser whose mistakes are explained as all others are: what is wrong, where, what to do."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from core_rasterizer.errors import ExplainedError

from .suggestions import did_you_mean


class CommandParser(argparse.ArgumentParser):
    """argparse's, which raises an `ExplainedError` where that one prints its usage and ends."""

    def error(self, message: str) -> NoReturn:
        """Refuse what was typed; the help says what is understood."""
        raise ExplainedError(
            message, where=self.prog, fix=f"`{self.prog} --help` shows what it takes, and examples"
        )

    # Its stub is overloaded by the namespace's type, which matters to nobody here.
    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> Any:
        """As argparse's, but the verb itself refuses what it does not know: its options are at hand."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = [name for action in self._actions for name in action.option_strings]
            first = unknown[0].partition("=")[0]
            self.error(f"{first!r} is not understood{did_you_mean(first, options)}")
        return parsed, unknown
