"""Memory that plugins allocate and keep."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import PluginError
from ..system.memory import available_bytes, resident_bytes

SHARE = 0.9
"""Of the memory that is available at the first call: what the process may add."""


class MemoryLedger:
    """Growth of the process during the calls of each component.

    Args:
        limit: most bytes that the process may hold; None: set from `SHARE` at the first call.
        resident: returns the bytes that it holds.
    """

    def __init__(
        self, limit: float | None = None, resident: Callable[[], int] = resident_bytes
    ) -> None:
        self._limit, self._resident = limit, resident
        self._grown: dict[str, int] = {}
        self._start: int | None = None

    def watching(self, who: str) -> _Watched:
        """Count the growth during the block for a component.

        Raises:
            PluginError: the process holds more than the limit, and at least half of its growth came
                during this component's calls.
        """
        return _Watched(self, who)

    def _begin(self) -> int:
        before = self._resident()
        if self._start is None:
            self._start = before
            if self._limit is None:
                self._limit = before + SHARE * available_bytes()
        return before

    def _end(self, who: str, before: int) -> None:
        now = self._resident()
        grown = self._grown[who] = self._grown.get(who, 0) + now - before
        if now > (self._limit or 0) and 2 * grown >= now - (self._start or 0):
            raise PluginError(
                f"memory runs out: the process holds {now / 1e6:,.0f} MB, of which this component "
                f"allocated {grown / 1e6:,.0f} MB",
                fix="let it keep no more than it needs, and no tensor in autograd (`tensor.detach()`)",
            )


class _Watched:
    __slots__ = ("_before", "_ledger", "_who")

    def __init__(self, ledger: MemoryLedger, who: str) -> None:
        self._ledger, self._who = ledger, who

    def __enter__(self) -> None:
        self._before = self._ledger._begin()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self._ledger._end(self._who, self._before)


LEDGER = MemoryLedger()
"""Counts all calls of the process."""
