"""Processor cores of this process."""

from __future__ import annotations

import math
import os
from pathlib import Path

_QUOTA = Path("/sys/fs/cgroup/cpu.max")


def usable_cores() -> int:
    """Number of cores that this process may use, at least 1: fewer than the machine's in a container."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    try:
        microseconds, period = map(int, _QUOTA.read_text("ascii").split())
    except (OSError, ValueError):  # no container, or "max"
        return cores
    return max(1, min(cores, math.ceil(microseconds / period)))
