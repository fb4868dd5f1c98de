"""Warn about calls into plugins that seem stuck, and end them if requested.

A daemon thread checks all calls once a second. A call costs one list entry and one look at its duration.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

from ..errors import PluginError

PATIENCE = 10.0
"""Multiple of the expected time that a call may stay silent before a warning."""
EXPECTED, EXPECTED_IN_LOOP = 60.0, 6.0
"""Seconds that a call is expected to take outside of the training loop and in it. More is expected if an
earlier call of the component, or a step of the stage, took longer."""
GRACE = 10.0
"""Seconds that a call has to end after it was interrupted, before the process is ended."""
HUNG = 2
"""Exit status of a process that is ended, as after all errors."""
_SIGNAL: Any = getattr(signal, "SIGVTALRM", None)
"""Interrupts a call; None on Windows. LLVM, which OpenCL drivers load, uses SIGUSR1 and SIGUSR2."""
_SHOW_CURSOR = "\x1b[?25h"  # a bar hides it
_RESUME = "`stereogs resume RUN` continues from the run's last checkpoint"

_log = logging.getLogger("stereogs")


@dataclass(eq=False, slots=True)
class Call:
    """A call into a plugin.

    Args:
        who: its text names the plugin.
        iteration: of training; None outside the loop.
        began: seconds of the watchdog's clock.
        interrupted: time of the first interrupt, or None.
    """

    who: object
    iteration: int | None
    began: float
    interrupted: float | None = None

    def __str__(self) -> str:
        return str(self.who) + (f", iteration {self.iteration}" if self.iteration else "")

    def error(self, what: str) -> PluginError:
        """Return an error with advice for this call."""
        fix = "report it to its authors if it hangs; otherwise give it more time with --hang-after"
        if self.iteration is not None:
            fix += f"; {_RESUME}"
        return PluginError(what, where=str(self), fix=fix)


class Hang(BaseException):
    """Raised within a call that takes too long; a plugin's `except Exception` does not catch it.

    Args:
        call: the call.
        seconds: its time limit.
    """

    def __init__(self, call: Call, seconds: float) -> None:
        self.call, self.seconds = call, seconds

    def explained(self) -> PluginError:
        """Return it as an `ExplainedError`."""
        return self.call.error(f"no answer came within {self.seconds:g} s")


class Watchdog:
    """Records the calls of all threads.

    Args:
        look_every: seconds between two checks; None: only when `look` is called.
        grace: see `GRACE`.
        clock: returns seconds.
    """

    def __init__(
        self,
        look_every: float | None = 1.0,
        grace: float = GRACE,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._look_every, self._grace, self._clock = look_every, grace, clock
        self._calls: dict[int, list[Call]] = {}  # by thread, the innermost last
        self._longest: dict[object, float] = {}
        self._latest, self._longest_step, self._warned = -math.inf, 0.0, False
        self._limit: float | None = None
        self._thread: threading.Thread | None = None

    def watching(self, who: object, iteration: int | None = None) -> _Watching:
        """Watch the block as a call.

        Args:
            who: its text names the plugin.
            iteration: of training; None outside the loop.
        """
        return _Watching(self, who, iteration)

    def _begin(self, who: object, iteration: int | None) -> tuple[list[Call], int, float]:
        """Record a call; return the calls of this thread, their number before, and the time."""
        if self._thread is None and self._look_every is not None:
            self._thread = threading.Thread(
                target=self._watch, name="stereogs watchdog", daemon=True
            )
            self._thread.start()
        calls = self._calls.setdefault(threading.get_ident(), [])
        depth, began = len(calls), self._clock()
        calls.append(Call(who, iteration, began))
        return calls, depth, began

    def _end(self, who: object, calls: list[Call], depth: int, began: float) -> None:
        del calls[depth:]  # a `Hang` may have skipped the end of an inner block
        took = self._clock() - began
        if took > self._longest.get(who, 0.0):
            self._longest[who] = took

    def progressed(self, *, began: bool) -> None:
        """Note a report of progress; `began`: of a new stage, in which there may be a warning again."""
        now = self._clock()
        self._longest_step = 0.0 if began else max(self._longest_step, now - self._latest)
        self._latest, self._warned = now, self._warned and not began

    @contextmanager
    def ending(self, seconds: float | None) -> Iterator[None]:
        """Within the block, raise `Hang` in calls of the main thread that take longer.

        If a call does not end, because it is stuck in a library, the process is ended.

        Args:
            seconds: > 0; None: no limit.
        """
        main = threading.current_thread() is threading.main_thread()
        if seconds is None or not main or _SIGNAL is None:
            yield
            return
        previous = signal.signal(_SIGNAL, self._raise)
        self._limit = seconds
        try:
            yield
        finally:
            self._limit = None
            signal.signal(_SIGNAL, previous)

    def _watch(self) -> None:
        while True:
            time.sleep(self._look_every or 0)
            self.look()

    def look(self) -> None:
        """Warn, once in each stage, of a call that is silent for too long; interrupt one over the limit."""
        for calls in [] if self._warned else list(self._calls.values()):
            silent = next(filter(self._is_silent, reversed(calls.copy())), None)
            if silent is not None:
                self._warned = True
                end = f"Ctrl-C, twice; {_RESUME}" if silent.iteration else "Ctrl-C"
                _log.warning(
                    "%s has been running for %.0f s, much longer than expected. If it hangs, end it "
                    "with %s",
                    *(silent, self._clock() - silent.began, end),
                )
                break
        self._interrupt()

    def _is_silent(self, call: Call) -> bool:
        expected = EXPECTED if call.iteration is None else EXPECTED_IN_LOOP
        expected = max(expected, self._longest_step, self._longest.get(call.who, 0.0))
        return self._clock() - max(call.began, self._latest) >= PATIENCE * expected

    def _interrupt(self) -> None:
        hung, now = self._hung(), self._clock()
        if hung is None:
            return
        if hung.interrupted is None:
            hung.interrupted = now
        if now - hung.interrupted > self._grace:
            error = hung.error(
                f"no answer came within {now - hung.began:.0f} s, and the call could not be interrupted"
            )
            end = _SHOW_CURSOR if sys.stderr.isatty() else ""
            print(f"stereogs: {error}{end}", file=sys.__stderr__, flush=True)
            os._exit(HUNG)
        if sys.platform != "win32":  # where `ending` sets no limit
            signal.pthread_kill(_main_thread(), _SIGNAL)

    def _hung(self) -> Call | None:
        """Return the innermost call of the main thread that takes too long."""
        if self._limit is None:
            return None
        now, limit = self._clock(), self._limit
        calls = reversed(self._calls.get(_main_thread(), []).copy())
        return next((call for call in calls if now - call.began >= limit), None)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        hung = self._hung()
        if hung is not None and self._limit is not None:
            raise Hang(hung, self._limit)


class _Watching:
    __slots__ = ("_begun", "_dog", "_iteration", "_who")

    def __init__(self, dog: Watchdog, who: object, iteration: int | None) -> None:
        self._dog, self._who, self._iteration = dog, who, iteration

    def __enter__(self) -> None:
        self._begun = self._dog._begin(self._who, self._iteration)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._dog._end(self._who, *self._begun)


WATCHDOG = Watchdog()
"""Watches all calls of the process."""


def _main_thread() -> int:
    return threading.main_thread().ident or 0
