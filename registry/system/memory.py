"""How much memory this process takes."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_STATUS = Path("/proc/self/status")
_FORGET = Path("/proc/self/clear_refs")
_FORGET_THE_PEAK = "5"
_CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")


def machine_memory() -> int | None:
    """Bytes that this machine has, or this container may use; None where nobody tells (Windows)."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None
    try:
        return min(machine, int(_CONTAINER_LIMIT.read_text("utf-8")))
    except (OSError, ValueError):  # no container, or one that says "max"
        return machine


def peak_memory_mb() -> float | None:
    """The largest resident set so far, in megabytes of 10^6 bytes; None where nobody counts it."""
    if _STATUS.exists():
        # Linux. getrusage would start from the peak of whoever started this process.
        return _resident("VmHWM")
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak_usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts in bytes, others in KiB.
    return float(peak_usage if sys.platform == "darwin" else peak_usage * 1024) / 1e6


@dataclass
class Added:
    """What a block added to the resident set, in megabytes of 10^6 bytes; None where nobody counts it.

    Memory that the process had taken before and not given back is used again unseen.
    """

    megabytes: float | None = None


@contextmanager
def memory_added() -> Iterator[Added]:
    """Measure a block; Linux alone can be asked to forget an earlier peak (proc(5), `clear_refs`)."""
    added = Added()
    try:
        _FORGET.write_text(_FORGET_THE_PEAK)
    except OSError:
        yield added
        return
    before = _resident("VmRSS")
    yield added
    peak = _resident("VmHWM")
    if before is not None and peak is not None:
        added.megabytes = max(0.0, peak - before)


def _resident(name: str) -> float | None:
    found = re.search(rf"^{name}:\s+(\d+) kB$", _STATUS.read_text("utf-8"), re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else None
