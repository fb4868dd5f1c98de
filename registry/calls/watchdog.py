"""Warn about calls into plugins that take long, and end them if requested.

A daemon thread checks the duration of all calls once a second. A call costs one list entry.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

from ..errors import PluginError

WARN_AFTER = 60.0
"""Seconds until the first warning about a call; the next follow whenever the time has doubled."""
GRACE = 10.0
"""Seconds that a call has to end after it was interrupted, before the process is ended."""
HUNG = 2
"""Exit status of a process that is ended, as after all errors."""
_SIGNAL: Any = getattr(signal, "SIGVTALRM", None)
"""Interrupts a call; None on Windows. LLVM, which OpenCL drivers load, uses SIGUSR1 and SIGUSR2."""
_RESUME = "`stereogs resume RUN` continues from the run's last checkpoint"

_log = logging.getLogger("stereogs")


@dataclass(eq=False)
class Call:
    """A call into a plugin.

    Args:
        who: its text names the plugin.
        iteration: of training; None outside the loop.
        began: time of the monotonic clock.
        warnings: number of warnings about this call.
        interrupted: time of the first interrupt, or None.
    """

    who: object
    iteration: int | None
    began: float
    warnings: int = 0
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
        warn_after, grace: see `WARN_AFTER` and `GRACE`.
        look_every: seconds between two checks.
    """

    def __init__(
        self, warn_after: float = WARN_AFTER, look_every: float = 1.0, grace: float = GRACE
    ) -> None:
        self._warn_after, self._look_every, self._grace = warn_after, look_every, grace
        self._calls: dict[int, list[Call]] = {}  # by thread, the innermost last
        self._limit: float | None = None
        self._thread: threading.Thread | None = None

    @contextmanager
    def watching(self, who: object, iteration: int | None = None) -> Iterator[None]:
        """Watch the block as a call.

        Args:
            who: its text names the plugin.
            iteration: of training; None outside the loop.
        """
        if self._thread is None:
            self._thread = threading.Thread(
                target=self._watch, name="stereogs watchdog", daemon=True
            )
            self._thread.start()
        calls = self._calls.setdefault(threading.get_ident(), [])
        depth = len(calls)
        calls.append(Call(who, iteration, time.monotonic()))
        try:
            yield
        finally:
            del calls[depth:]  # a `Hang` may have skipped the end of an inner block

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
            time.sleep(self._look_every)
            for calls in list(self._calls.values()):
                self._warn(calls)
            self._interrupt()

    def _warn(self, calls: list[Call]) -> None:
        call = _innermost(calls, self._warn_after)
        if call is None:
            return
        seconds = time.monotonic() - call.began
        if seconds >= self._warn_after * 2**call.warnings:
            call.warnings += 1
            end = "Ctrl-C" if call.iteration is None else f"Ctrl-C, twice; {_RESUME}"
            _log.warning(
                "%s has been running for %.0f s. If it hangs, end it with %s. "
                "`stereogs train --hang-after SECONDS` ends such calls",
                *(call, seconds, end),
            )

    def _interrupt(self) -> None:
        hung, now = self._hung(), time.monotonic()
        if hung is None:
            return
        if hung.interrupted is None:
            hung.interrupted = now
        if now - hung.interrupted > self._grace:
            error = hung.error(
                f"no answer came within {now - hung.began:.0f} s, and the call could not be interrupted"
            )
            print(f"stereogs: {error}", file=sys.stderr, flush=True)
            os._exit(HUNG)
        signal.pthread_kill(_main_thread(), _SIGNAL)

    def _hung(self) -> Call | None:
        """Return the innermost call of the main thread that takes too long."""
        if self._limit is None:
            return None
        return _innermost(self._calls.get(_main_thread(), []), self._limit)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        hung = self._hung()
        if hung is not None and self._limit is not None:
            raise Hang(hung, self._limit)


WATCHDOG = Watchdog()
"""Watches all calls of the process."""


def _innermost(calls: list[Call], seconds: float) -> Call | None:
    """Return the innermost call that has taken so long."""
    now = time.monotonic()
    return next((call for call in reversed(calls.copy()) if now - call.began >= seconds), None)


def _main_thread() -> int:
    return threading.main_thread().ident or 0
