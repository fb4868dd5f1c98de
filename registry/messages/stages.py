"""Stages of long work: what components report, how much time is left, and how a console shows it.

A component calls `progress("depth", done, total)` while it works. The command line shows a bar on a terminal,
else a line per stage and one every ten seconds. The watchdog sees that the call is not stuck.
"""

from __future__ import annotations

import sys
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

Item = TypeVar("Item")

_LEAST_SECONDS, _LEAST_STEPS = 3.0, 2
"""Until both have passed, the time left is not known."""
_SAMPLE_SECONDS, _MOST_SAMPLES = 0.5, 2000
_TREND_STEPS, _TREND_LIMIT = 10, 1.5
"""Least number of steps for a trend, and the largest factor by which it lengthens the rest. The last
iterations of a training take two to six times as long as the first."""
_SECONDS_BETWEEN_LINES = 10.0
_BAR, _NAME = 20, 9
"""Width of the bar, and of the name before it."""
_DRAWN_PER_SECOND = 4


class Stage:
    """A part of the work, with the times of its steps.

    Args:
        name: one or two words, for example "depth".
        done, total: number of steps; `total` is None if it is not known.
        now: seconds of the clock.

    Attributes:
        began, latest: times of the first and the latest report.
        longest_step: most seconds between two reports.
        detail: returns more text about the state, or "".
    """

    def __init__(self, name: str, done: int, total: int | None, now: float) -> None:
        self.name, self.done, self.total = name, done, total
        self.began = self.latest = now
        self.longest_step = 0.0
        self.detail: Callable[[], str] = str
        self._samples = [(done, now)]

    def includes(self, name: str, done: int, total: int | None) -> bool:
        """Whether a report is about this stage rather than a new one."""
        again = done == 0 < self.done
        return name == self.name and self.total in (None, total) and not again

    def reached(self, done: int, now: float) -> None:
        """Record a report."""
        self.longest_step = max(self.longest_step, now - self.latest)
        self.latest = now
        if done > self.done:
            self.done = done
            if now - self._samples[-1][1] >= _SAMPLE_SECONDS:
                self._samples.append((done, now))
                if len(self._samples) > _MOST_SAMPLES:
                    del self._samples[1::2]

    def seconds_left(self, now: float) -> float | None:
        """Estimate the rest from the second half of the steps so far; None until it is known.

        If steps have become slower, they are expected to become slower still.
        """
        (first, began), (done, latest) = self._samples[0], self._samples[-1]
        steps = done - first
        if self.total is None or latest - began < _LEAST_SECONDS or steps < _LEAST_STEPS:
            return None
        middle = bisect_right(self._samples, (first + steps // 2, latest)) - 1
        half, split = self._samples[min(middle, len(self._samples) - 2)]
        step = (latest - split) / (done - half)
        left = (self.total - done) * step
        if half > first and steps >= _TREND_STEPS:
            slower = 1 - (split - began) / (half - first) / step
            left *= min(max(1 + slower * (self.total - half) / steps, 1), _TREND_LIMIT)
        return max(left - (now - latest), 0.0)

    def text(self, now: float, *, running: bool) -> str:
        """Return the steps, the time left or, after the end, the time taken, and the detail."""
        left = self.seconds_left(now) if running else None
        parts = [f"{self.done}/{self.total}"] if self.total else []
        if left is not None:
            parts.append(f"{_minutes(left)} left")
        elif not running:
            parts.append(f"{now - self.began:.1f} s")
        elif not self.total:
            parts.append(_minutes(now - self.began))
        return "  ".join(filter(None, (*parts, self.detail())))


class Stages:
    """The stage that the process is in, and what shows it.

    Args:
        clock: returns seconds; replaced by tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.current: Stage | None = None
        self.displays: list[StageDisplay] = []
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
                current.reached(current.done, now)
            elif current is None or not current.includes(stage, done, total):
                self.begin(Stage(stage, done, total, now))
            else:
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


class StageDisplay:
    """Shows stages on a console: a bar in the last line of a terminal, else lines.

    Attributes:
        has_bar: whether there is a terminal; other text must then be printed on `console`.
    """

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self.console = console
        self.has_bar = console.is_terminal and not console.quiet
        self._printed = 0.0
        self._live = Live(
            get_renderable=self.bar,
            console=console,
            transient=True,
            refresh_per_second=_DRAWN_PER_SECOND,
            redirect_stderr=sys.stderr.isatty(),
        )

    def __enter__(self) -> None:
        if self.has_bar:
            self._live.start()

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def begun(self, stage: Stage) -> None:
        """Print a line if there is no bar."""
        if not self.has_bar:
            self._print(stage, f"{stage.done}/{stage.total}" if stage.total else "")

    def reached(self, stage: Stage) -> None:
        """Print a line every ten seconds if there is no bar."""
        if not self.has_bar and stage.latest - self._printed >= _SECONDS_BETWEEN_LINES:
            self._print(stage, stage.text(stage.latest, running=True))

    def ended(self, stage: Stage) -> None:
        """Print how long it took in place of the bar; without a bar only where there is a detail."""
        if self.has_bar or stage.detail():
            self._print(stage, stage.text(STAGES.clock(), running=False))

    def _print(self, stage: Stage, text: str) -> None:
        self._printed = STAGES.clock()
        self.console.print(f"{stage.name:<{_NAME}} {text}".rstrip())

    def bar(self) -> Text:
        """Return the bar, at most as wide as the terminal."""
        from rich.text import Text

        stage = STAGES.current
        if stage is None:
            return Text("")
        line = Text(f"{stage.name:<{_NAME}} ", no_wrap=True, overflow="crop")
        if stage.total:
            full, empty = "#-" if self.console.options.ascii_only else "━─"
            filled = _BAR * min(stage.done, stage.total) // stage.total
            line.append(full * filled, "green").append(
                empty * (_BAR - filled) + " ", "bright_black"
            )
        line.append(stage.text(STAGES.clock(), running=True))
        line.truncate(self.console.width - 1)
        return line


@contextmanager
def showing(console: Console) -> Iterator[None]:
    """Show the stages within the block on a console, the first of them "reading"; end the last after it.

    Within another such block for the same console only end the stage.
    """
    if any(display.console is console for display in STAGES.displays):
        yield
        STAGES.begin(None)
        return
    outer, STAGES.current = STAGES.current, None
    display = StageDisplay(console)
    with display:
        STAGES.displays.append(display)
        try:
            progress("reading")
            yield
            STAGES.begin(None)
        finally:
            STAGES.displays.remove(display)
            STAGES.current = outer


def console_of_bar() -> Console | None:
    """Return the console of the bar on the terminal, if one is shown."""
    return next((shown.console for shown in STAGES.displays if shown.has_bar), None)


def _minutes(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
