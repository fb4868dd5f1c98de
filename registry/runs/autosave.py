"""Checkpoints by the clock."""

from __future__ import annotations

from time import monotonic

from .run import Run

AUTOMATIC_SECONDS = 30.0
"""How old the newest checkpoint may become, whatever the pipeline says about checkpoints."""
AUTOMATIC_SHARE = 0.005
"""Of the time, that saving may take; where it takes long, checkpoints become older."""


class Autosave:
    """Checkpoints by the clock, so that a run that is killed loses little."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._last, self._cost = monotonic(), 0.0

    def due(self) -> bool:
        """Whether the newest checkpoint is old."""
        return monotonic() - self._last > max(AUTOMATIC_SECONDS, self._cost / AUTOMATIC_SHARE)

    def save(self) -> None:
        """Save one now."""
        begin = monotonic()
        self._run.save_checkpoint()
        self._last = monotonic()
        self._cost = self._last - begin
