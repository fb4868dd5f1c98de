"""The state of a training at each number of seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

State = TypeVar("State")
_WINDOW = 100
"""Iterations whose longest duration tells when to begin to copy."""
_OLDEST = 0.01
"""Largest age of the copy, as a share of the budget, in case an iteration suddenly takes longer."""


class Snapshot(NamedTuple, Generic[State]):
    """The state after a number of seconds."""

    seconds: float
    state: State


@dataclass
class Snapshots(Generic[State]):
    """Keeps the last state that was complete within each budget.

    States are copied shortly before a budget ends, and before that whenever the copy has become too old, so
    few copies are made. If one iteration takes much longer than those before, the state that is kept may
    be older than the last complete one, by at most 1 % of the budget.

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
        if self._waiting and (now + soon >= self._waiting[0] or self._is_old(now)):
            self._latest = Snapshot(now, self.copy())

    def _is_old(self, now: float) -> bool:
        return self._latest is None or now - self._latest.seconds > _OLDEST * self._waiting[0]
