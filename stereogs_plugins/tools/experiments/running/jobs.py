"""How many trainings run at the same time unless the user says."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from core_rasterizer import Device

CORES_PER_RUN = 4
"""One training keeps about so many cores busy; more trainings on fewer cores end no sooner."""
MEMORY_PER_RUN_MB = 2000.0
"""What a training is taken to need before one has been measured."""
_MEMINFO = Path("/proc/meminfo")


def default_jobs(device: Device, peaks_mb: Iterable[float]) -> int:
    """As many as cores and free memory allow; one on a GPU, which one training fills.

    Args:
        peaks_mb: what finished runs of this ablation needed.
    """
    if device.kind != "cpu":
        return 1
    by_cores = _cores() // CORES_PER_RUN
    free = free_memory_mb()
    by_memory = 1 if free is None else int(free // max(peaks_mb, default=MEMORY_PER_RUN_MB))
    return max(1, min(by_cores, by_memory))


def free_memory_mb() -> float | None:
    """Memory that new processes can have, in megabytes of 10^6 bytes; None where nobody tells."""
    if not _MEMINFO.exists():
        return None
    found = re.search(r"^MemAvailable:\s+(\d+) kB$", _MEMINFO.read_text("utf-8"), re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else None


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
