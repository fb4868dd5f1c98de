"""Calls into plugins that do not come back: told of, and ended where that is wanted.

A daemon thread looks at the time each call began, once a second. A call that takes no second costs two
entries of a dictionary.
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

from ..errors import PluginError

TELL_AFTER = 60.0
"""Seconds after which a call that has not come back is told of; again whenever they have doubled."""
GRACE = 10.0
"""Seconds that a call has to heed the request to end, before the process ends."""
HUNG = 2
"""The exit status then: that of every error that was explained."""
_SIGNAL = "SIGVTALRM"
"""What interrupts a call. SIGUSR1 and SIGUSR2 are LLVM's, which OpenCL drivers bring along."""

_log = logging.getLogger("stereogs")


@dataclass(eq=False)
class Call:
    """Somebody at work.

    Args:
        who: whose text says who it is.
        iteration: of training; None outside the loop.
        began: by the monotonic clock.
        caller: on whose behalf: the initializer that asks a prior.
        told: how often it was told of.
    """

    who: object
    iteration: int | None
    began: float
    caller: Call | None
    told: int = 0

    def chain(self) -> Iterator[Call]:
        """This call, the one that made it, and so on."""
        call: Call | None = self
        while call is not None:
            yield call
            call = call.caller

    def __str__(self) -> str:
        return str(self.who) + (f", iteration {self.iteration}" if self.iteration else "")


class Hang(BaseException):
    """Raised within a call that takes too long; no `except Exception` of a plugin stops it.

    Args:
        call: the one that does not come back.
        seconds: how long it was given.
    """

    def __init__(self, call: Call, seconds: float) -> None:
        self.call, self.seconds = call, seconds

    def explained(self) -> PluginError:
        """The same as an error for people."""
        return PluginError(
            f"no answer came within {self.seconds:g} s",
            where=str(self.call),
            fix=_mend(self.call),
        )


class Watchdog:
    """Knows who is at work in which thread.

    Args:
        tell_after: see `TELL_AFTER`.
        look_every: seconds between two looks.
        grace: see `GRACE`.
    """

    def __init__(
        self, tell_after: float = TELL_AFTER, look_every: float = 1.0, grace: float = GRACE
    ) -> None:
        self._tell_after, self._look_every, self._grace = tell_after, look_every, grace
        self._calls: dict[int, Call] = {}
        self._limit: float | None = None
        self._asked: dict[Call, float] = {}
        self._thread: threading.Thread | None = None

    @contextmanager
    def watching(self, who: object, iteration: int | None = None) -> Iterator[None]:
        """Somebody is at work within the block.

        Args:
            who: whose text says who it is.
            iteration: of training; None outside the loop.
        """
        thread = threading.get_ident()
        caller = self._calls.get(thread)
        if self._thread is None:
            self._start()
        self._calls[thread] = Call(who, iteration, time.monotonic(), caller)
        try:
            yield
        finally:
            if caller is None:
                del self._calls[thread]
            else:
                self._calls[thread] = caller

    @contextmanager
    def ending(self, seconds: float | None) -> Iterator[None]:
        """Within the block, calls of the main thread that take longer are ended by a `Hang`.

        A call that does not heed it, because it is stuck in a library, ends the process.

        Args:
            seconds: > 0; None ends none.
        """
        number = getattr(signal, _SIGNAL, None)
        main = threading.current_thread() is threading.main_thread()
        if seconds is None or not main or number is None:
            yield
            return
        previous = signal.signal(number, self._raise)
        self._limit = seconds
        try:
            yield
        finally:
            self._limit = None
            signal.signal(number, previous)

    def look(self) -> None:
        """Tell of calls that take long, and ask those to end that take too long."""
        now = time.monotonic()
        for innermost in list(self._calls.values()):
            call = next((c for c in innermost.chain() if now - c.began >= self._tell_after), None)
            if call is not None and now - call.began >= self._tell_after * 2**call.told:
                call.told += 1
                _log.warning(
                    "%s has been at work for %.0f s. %s", call, now - call.began, _advice(call)
                )
        hung = self._hung()
        if hung is None:
            return
        since = self._asked.setdefault(hung, now)
        if now - since > self._grace:
            _end_process(hung, now - hung.began)
        signal.pthread_kill(_main_thread(), getattr(signal, _SIGNAL))

    def _hung(self) -> Call | None:
        """The innermost call of the main thread that takes too long."""
        innermost, limit = self._calls.get(_main_thread()), self._limit
        if innermost is None or limit is None:
            return None
        now = time.monotonic()
        return next((call for call in innermost.chain() if now - call.began > limit), None)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        hung = self._hung()
        if hung is not None and self._limit is not None:
            raise Hang(hung, self._limit)

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._watch, name="stereogs watchdog", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while True:
            time.sleep(self._look_every)
            self.look()


WATCHDOG = Watchdog()
"""The process's own."""


def _main_thread() -> int:
    ident = threading.main_thread().ident
    assert ident is not None  # it has started: this code runs
    return ident


def _advice(call: Call) -> str:
    end = "If it hangs, end it with Ctrl-C"
    if call.iteration is not None:
        end += f", twice; {_RESUME}"
    return f"{end}. `stereogs train --hang-after SECONDS` ends such calls by itself"


def _mend(call: Call) -> str:
    fix = "report it to its authors if it hangs; else give it more time with --hang-after"
    return fix if call.iteration is None else f"{fix}; {_RESUME}"


_RESUME = "`stereogs resume RUN` goes on from the run's last checkpoint"


def _end_process(call: Call, seconds: float) -> None:
    print(
        f"stereogs: no answer came within {seconds:.0f} s, and the request to end was not heeded\n"
        f"  where  {call}\n  fix    {_mend(call)}",
        file=sys.stderr,
        flush=True,
    )
    os._exit(HUNG)
