"""metrics.jsonl: how training went, a line every few iterations."""

from __future__ import annotations

import math
from typing import Any

from ..training.trainer import Iteration
from .folder import RunFolder

EVERY = 50
"""Iterations that share a line."""


class MetricsLog:
    """Averages what iterations log, and writes the averages.

    Args:
        run: where metrics.jsonl lies.
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
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
        self._run.append_metrics(jsonable(line))


def jsonable(value: Any) -> Any:
    """Plain values with infinities and not-a-numbers as None."""
    if isinstance(value, dict):
        return {key: jsonable(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(child) for child in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
