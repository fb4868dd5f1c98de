"""How an ablation is going: a bar on a terminal, a line for each run elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from registry.runs.progress import ShownBar


class AblationProgress(ShownBar):
    """Shows how many runs are done, which are at work, and the time left.

    Args:
        total: how many runs there are to train.
        console: a bar if it is a terminal.
    """

    def __init__(self, total: int, console: Console) -> None:
        self._total, self._done, self._console = total, 0, console
        bar = Progress(
            TextColumn("{task.fields[done]}/{task.total} runs"),
            BarColumn(),
            TextColumn("{task.fields[at_work]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        super().__init__(bar)
        self._task = bar.add_task("ablation", total=total, done=0, at_work="")

    def ended(self, name: str, failure: str) -> None:
        """Tell of a run that has ended; `failure` is empty if it is finished."""
        self._done += 1
        self._console.print(f"{self._done}/{self._total}  {name}  {failure or 'finished'}")

    def show(self, parts: Sequence[float]) -> None:
        """Show those at work, each by its share that is done; a bar counts their iterations."""
        if not self._console.is_terminal:
            return
        self._bar.update(
            self._task,
            completed=self._done + sum(parts),
            done=self._done,
            at_work=", ".join(f"{part:.0%}" for part in parts),
        )
