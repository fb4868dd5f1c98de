"""Progress of a training: a bar on a terminal, plain lines elsewhere, and metrics.jsonl."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from ..system.files import jsonable
from ..training.trainer import Iteration

EVERY = 50
"""Iterations that share a line of metrics.jsonl."""
_SECONDS_BETWEEN_LINES = 10.0
_SMOOTHING = 0.05
"""Weight of the newest loss in the shown one: the losses of single views differ too much."""


class ShownBar:
    """Shows a bar within a `with` block.

    Args:
        bar: shown if its console is a terminal.
    """

    def __init__(self, bar: Progress) -> None:
        self._bar = bar

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._bar.stop()


class TrainingProgress(ShownBar):
    """Shows loss, number of Gaussians, iterations per second and time left.

    Args:
        first: the last iteration before training.
        total: the last iteration.
        console: shows a bar on a terminal, else a line every ten seconds.
    """

    def __init__(self, first: int, total: int, console: Console) -> None:
        self._total, self._console = total, console
        self._begin, self._begin_iteration = time.monotonic(), first
        self._last_line = self._begin
        self._loss: float | None = None
        bar = Progress(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("loss {task.fields[loss]:.4f}"),
            TextColumn("{task.fields[gaussians]:,} Gaussians"),
            TextColumn("{task.fields[speed]:.1f} it/s"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        super().__init__(bar)
        self._task = bar.add_task(
            "training", total=total, completed=first, loss=0.0, gaussians=0, speed=0.0
        )

    def update(self, iteration: int, loss: float, gaussians: int) -> None:
        """Show a complete iteration."""
        smooth = loss if self._loss is None else self._loss + _SMOOTHING * (loss - self._loss)
        self._loss = smooth
        now = time.monotonic()
        speed = (iteration - self._begin_iteration) / max(now - self._begin, 1e-9)
        if self._console.is_terminal:
            self._bar.update(
                self._task, completed=iteration, loss=smooth, gaussians=gaussians, speed=speed
            )
        elif now - self._last_line >= _SECONDS_BETWEEN_LINES or iteration == self._total:
            self._last_line = now
            left = int((self._total - iteration) / max(speed, 1e-9))
            self._console.print(
                f"iteration {iteration}/{self._total}  loss {smooth:.4f}  "
                f"{gaussians:,} Gaussians  {speed:.1f} it/s  {left // 60}:{left % 60:02d} left"
            )


class MetricsLog:
    """Averages the numbers of iterations into lines of metrics.jsonl.

    Args:
        write_line: receives each line.
    """

    def __init__(self, write_line: Callable[[dict[str, Any]], None]) -> None:
        self._write_line = write_line
        self._sums: dict[str, tuple[float, int]] = {}

    def add(self, done: Iteration, seconds: float, *, last: bool) -> None:
        """Add an iteration; write a line in every 50th iteration and in the last.

        Args:
            seconds: training time so far.
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
        """Write a line; infinite and NaN become null."""
        self._write_line(jsonable(line))
