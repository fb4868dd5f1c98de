"""How training is going: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

_SECONDS_BETWEEN_LINES = 10.0
_SMOOTHING = 0.05
"""Weight of the newest loss in the shown one: single views differ too much to be read."""


class ShownBar:
    """Shows a bar as long as it is entered.

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
        first: the iteration that training starts after.
        total: the last iteration.
        console: where to write; a bar if it is a terminal, else a line now and then.
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
        """Tell of an iteration that is complete."""
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
