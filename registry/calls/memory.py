"""Memory that plugins take and do not give back."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import PluginError

SHARE = 0.9
"""Of the memory that is available when the first component is called."""


def resident_bytes() -> int:
    """What the process holds in memory; 0 where the system does not say (it is Linux that does)."""
    try:
        file = os.open("/proc/self/statm", os.O_RDONLY)
    except OSError:
        return 0
    try:
        return int(os.read(file, 64).split()[1]) * os.sysconf("SC_PAGE_SIZE")
    finally:
        os.close(file)


def available_bytes() -> float:
    """What the machine, or the container, has left; infinite where it does not say."""
    left = [_container_bytes()]
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        lines = []
    left += [1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    return min(left)


def _container_bytes() -> float:
    folder = Path("/sys/fs/cgroup")
    try:
        limit, used = (
            (folder / f"memory.{name}").read_text("ascii") for name in ("max", "current")
        )
        return float("inf") if limit.strip() == "max" else float(limit) - float(used)
    except (OSError, ValueError):
        return float("inf")


class MemoryLedger:
    """By how much the process grew while each component was at work.

    Args:
        limit: bytes that the process may hold; None: a share of what is available at the first call.
        resident: says how many it holds.
    """

    def __init__(
        self, limit: float | None = None, resident: Callable[[], int] = resident_bytes
    ) -> None:
        self._limit, self._resident = limit, resident
        self._grown: dict[str, int] = {}
        self._start: int | None = None

    @contextmanager
    def watching(self, who: str) -> Iterator[None]:
        """Somebody is at work within the block.

        Raises:
            PluginError: beyond the limit, if at least half of the growth came within such blocks of
                theirs.
        """
        before = self._resident()
        if self._start is None:
            self._start = before
            if self._limit is None:
                self._limit = before + SHARE * available_bytes()
        yield
        now = self._resident()
        grown = self._grown[who] = self._grown.get(who, 0) + now - before
        if now > (self._limit or 0) and 2 * grown >= now - self._start:
            raise PluginError(
                f"memory runs out: the process holds {now / 1e6:,.0f} MB, and {grown / 1e6:,.0f} MB of "
                "it came while this component was at work",
                fix="let it keep no more than it needs, and no tensor in autograd (`tensor.detach()`)",
            )


LEDGER = MemoryLedger()
"""The process's own."""
