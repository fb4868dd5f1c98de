"""The state of a training at each number of seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

State = TypeVar("State")
_WINDOW = 100
"""Iterations whose longest duration tells when to begin to copy."""


class Snapshot(NamedTuple, Generic[State]):
    """The state after a number of seconds."""

    seconds: float
    state: State


@dataclass
class Snapshots(Generic[State]):
    """Keeps the last state that was complete within each budget.

    States are copied only shortly before a budget ends, so few copies are made.

    Args:
        budgets: seconds.
        copy: returns a copy of the current state.

    Attributes:
        kept: the state by budget, for budgets that passed; a budget in which nothing was complete is missing.
        seconds: of the last state.
    """

    budgets: Sequence[float]
    copy: Callable[[], State]
    kept: dict[float, Snapshot[State]] = field(default_factory=dict)
    seconds: float = 0.0
    _latest: Snapshot[State] | None = None
    _durations: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    def __post_init__(self) -> None:
        self._waiting = sorted(self.budgets)

    def complete(self, now: float) -> None:
        """Note that the current state was complete `now`; the first one is the start of training."""
        if self.seconds:
            self._durations.append(now - self.seconds)
        self.seconds = now
        while self._waiting and now > self._waiting[0]:
            passed = self._waiting.pop(0)
            if self._latest is not None:
                self.kept[passed] = self._latest
        soon = 2 * max(self._durations, default=float("inf"))
        if self._waiting and now + soon >= self._waiting[0]:
            self._latest = Snapshot(now, self.copy())
