"""Stages of long work: what components report, and how much time is left."""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, TypeVar

from ...calls.watchdog import WATCHDOG, Watchdog

Item = TypeVar("Item")

_MIN_SECONDS, _MIN_SHARE, _MAX_AWAITED = 3.0, 6, 10
"""The time left is known after so many seconds and a sixth of the steps, which are at least 2 and at most 10:
the first iterations may compile kernels."""
_SAMPLE_SECONDS, _MAX_SAMPLES = 0.5, 2000
_TREND_LIMIT = 1.5
"""Largest factor by which a trend lengthens the rest. The last iterations of a training take two to six times
as long as the first."""


class Stage:
    """A part of the work, with the times of its steps.

    Args:
        name: one or two words, for example "depth".
        done, total: number of steps; `total` is None if it is not known.
        now: seconds of the clock.

    Attributes:
        began, latest: times of the first and the latest report.
        growth: expected mean duration of a later step in units of the first sixth's.
        detail: returns more text about the state, or "".
    """

    def __init__(self, name: str, done: int, total: int | None, now: float) -> None:
        self.name, self.done, self.total = name, done, total
        self.began = self.latest = now
        self.growth = 1.0
        self.detail: Callable[[], str] = str
        self._samples = [(done, now)]

    def includes(self, name: str, done: int, total: int | None) -> bool:
        """Whether a report is about this stage rather than a new one."""
        again = done == 0 < self.done
        return name == self.name and self.total in (None, total) and not again

    def reached(self, done: int, now: float) -> None:
        """Record a report."""
        self.latest = now
        if done > self.done:
            self.done = done
            if now - self._samples[-1][1] >= _SAMPLE_SECONDS:
                self._samples.append((done, now))
                if len(self._samples) > _MAX_SAMPLES:
                    del self._samples[1::2]

    def seconds_left(self, now: float) -> float | None:
        """Estimate the rest from the second half of the steps so far; None until it is known.

        If steps have become slower, they are expected to become slower still; during the first sixth of
        the steps also without that (`growth`).
        """
        (first, began), (done, latest) = self._samples[0], self._samples[-1]
        steps = done - first
        if self.total is None or latest - began < _MIN_SECONDS:
            return None
        if steps < min(max(self.total // _MIN_SHARE, 2), _MAX_AWAITED):
            return None
        middle = bisect_right(self._samples, (first + steps // 2, latest)) - 1
        half, split = self._samples[min(middle, len(self._samples) - 2)]
        step = (latest - split) / (done - half)
        growth = self.growth if steps * _MIN_SHARE < self.total else 1.0
        if half > first and steps >= _MAX_AWAITED:
            slower = 1 - (split - began) / (half - first) / step
            growth = max(growth, min(1 + slower * (self.total - half) / steps, _TREND_LIMIT))
        return max((self.total - done) * step * growth - (now - latest), 0.0)

    def text(self, now: float, *, running: bool) -> str:
        """Return the steps, the time left or, after the end, the time taken, and the detail."""
        left = self.seconds_left(now) if running and self.done != self.total else None
        parts = [f"{self.done}/{self.total}"] if self.total else []
        if left:
            parts.append(f"{_minutes(math.ceil(left))} left")
        elif not running:
            parts.append(f"{now - self.began:.1f} s")
        elif not self.total:
            parts.append(_minutes(now - self.began))
        return "  ".join(filter(None, (*parts, self.detail())))


class Display(Protocol):
    """Shows stages."""

    def begun(self, stage: Stage) -> None:
        """Called when a stage begins."""

    def reached(self, stage: Stage) -> None:
        """Called after each report of a stage."""

    def ended(self, stage: Stage) -> None:
        """Called when a stage has ended."""


class Stages:
    """The stage that the process is in, and what shows it.

    Args:
        clock, watchdog: replaced by tests.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, watchdog: Watchdog = WATCHDOG
    ) -> None:
        self.clock, self._watchdog = clock, watchdog
        self.current: Stage | None = None
        self.displays: list[Display] = []
        """The last one shows the stages."""
        self._fixed = False
        self._lock = threading.RLock()

    def report(self, stage: str, done: int = 0, total: int | None = None) -> None:
        """Report the stage that the work is in, from any thread and as often as you like.

        A new name, another total, or `done=0` after a larger one begins a stage; the one before ends.
        During training nothing is shown, but the watchdog sees that the work goes on.

        Args:
            stage: one or two words, for example "matching".
            done: number of finished steps.
            total: number of steps; None: not known.
        """
        now = self.clock()
        with self._lock:
            current = self.current
            if current is not None and self._fixed and stage != current.name:
                self._watchdog.progressed(began=False)
            elif current is None or not current.includes(stage, done, total):
                self.begin(Stage(stage, done, total, now))
            else:
                self._watchdog.progressed(began=False)
                current.total = total
                current.reached(done, now)
                for display in self.displays[-1:]:
                    display.reached(current)

    @contextmanager
    def fixed(self, stage: Stage) -> Iterator[None]:
        """Begin a stage, and stay in it within the block, whatever components report."""
        self.begin(stage)
        self._fixed = True
        try:
            yield
        finally:
            self._fixed = False

    def begin(self, stage: Stage | None) -> None:
        """Begin a stage, or None; the current one ends."""
        with self._lock:
            self._watchdog.progressed(began=True)
            ended, self.current = self.current, stage
            for display in self.displays[-1:]:
                if ended is not None:
                    display.ended(ended)
                if stage is not None:
                    display.begun(stage)


STAGES = Stages()
"""The stages of the process."""
progress = STAGES.report


def tracked(items: Sequence[Item], stage: str) -> Iterator[Item]:
    """Yield the items, and report before each how many are done: `for view in tracked(views, "depth")`."""
    for done, item in enumerate(items):
        progress(stage, done, len(items))
        yield item
    progress(stage, len(items), len(items))


def _minutes(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
