"""metrics.jsonl: how training went, a line every few iterations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...system.files import jsonable
from ...training.trainer import Iteration

EVERY = 50
"""Iterations that share a line."""


class MetricsLog:
    """Averages what iterations log, and writes the averages.

    Args:
        keep: takes each line.
    """

    def __init__(self, keep: Callable[[dict[str, Any]], None]) -> None:
        self._keep = keep
        self._sums: dict[str, tuple[float, int]] = {}

    def add(self, done: Iteration, seconds: float, *, last: bool) -> None:
        """Take an iteration in; writes a line in every 50th and in the last.

        Args:
            seconds: spent training so far.
        """
        for name, value in {"loss": done.loss, **done.logged}.items():
            total, count = self._sums.get(name, (0.0, 0))
            self._sums[name] = (total + value, count + 1)
        if last or done.number % EVERY == 0:
            means = {name: total / count for name, (total, count) in self._sums.items()}
            self._sums = {}
            line = {"iteration": done.number, "seconds": round(seconds, 3)}
            self.write({**line, "gaussians": done.gaussians, **means})

    def write(self, line: dict[str, Any]) -> None:
        """Write a line; numbers that JSON does not know become null."""
        self._keep(jsonable(line))
