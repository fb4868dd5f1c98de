"""Memory of this process and this machine."""

from __future__ import annotations

import errno
import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR_REFS = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"

FREE_MEMORY = (
    "end other programs, raise the memory limit of the process or container if it has one, or use smaller "
    "or fewer photographs and fewer Gaussians"
)
"""What a user can do if memory runs out."""
_FAILED = re.compile(
    r"allocate memory|failed to allocate|not enough memory|out of memory|insufficient memory|"
    r"bad[_ ]alloc|OUT_OF_HOST_MEMORY|MEM_OBJECT_ALLOCATION_FAILURE",
    re.IGNORECASE,
)
"""What torch, ONNX Runtime, OpenCV, C++ and OpenCL say, in errors of types without this meaning."""


def out_of_memory(error: BaseException) -> bool:
    """Return whether an error says that memory could not be allocated."""
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if not isinstance(error, Exception):
        return False
    with suppress(Exception):  # its __str__ fails
        return _FAILED.search(str(error)) is not None
    return False


def machine_memory() -> int | None:
    """Bytes that this machine has, or this container may use; None if unknown (Windows)."""
    if sys.platform == "win32":
        return None
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return None
    return int(min(machine, _container("max")))


def available_bytes() -> float:
    """Bytes that the machine, or the container, has left; infinite if unknown."""
    used = _container("current")
    container = _container("max") - used if used < math.inf else math.inf
    machine = _listed_bytes(Path("/proc/meminfo"), "MemAvailable")
    return container if machine is None else min(container, machine)


def resident_bytes() -> int:
    """Bytes that this process holds in memory; 0 if unknown (only Linux tells quickly)."""
    file, page = _statm()
    if sys.platform == "win32" or file is None:
        return 0
    return int(os.pread(file, 64, 0).split()[1]) * page


@cache
def _statm() -> tuple[int | None, int]:
    """Return an open file on the sizes of this process in pages, and the size of a page in bytes.

    Opening it at each call would take four times as long.
    """
    if sys.platform == "win32":
        return None, 0
    try:
        file = os.open("/proc/self/statm", os.O_RDONLY)
    except OSError:
        return None, 0
    os.register_at_fork(after_in_child=_statm.cache_clear)
    return file, os.sysconf("SC_PAGE_SIZE")


def peak_memory_mb() -> float | None:
    """The largest resident set so far, in megabytes of 10^6 bytes; None if unknown (Windows)."""
    if _STATUS.exists():
        # Linux, where getrusage would begin with the peak of the parent process.
        peak = _listed_bytes(_STATUS, "VmHWM")
        return None if peak is None else peak / 1e6
    if sys.platform == "win32":
        return None
    import resource

    peak_usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts in bytes, others in KiB.
    return float(peak_usage if sys.platform == "darwin" else peak_usage * 1024) / 1e6


@dataclass
class Added:
    """Growth of the resident set in megabytes of 10^6 bytes; None if unknown.

    Reuse of memory that the process already holds does not count.
    """

    megabytes: float | None = None


@contextmanager
def memory_added() -> Iterator[Added]:
    """Measure a block; only Linux can reset the peak (proc(5), `clear_refs`)."""
    added = Added()
    try:
        _CLEAR_REFS.write_text(_RESET_PEAK)
    except OSError:
        yield added
        return
    before = _listed_bytes(_STATUS, "VmRSS")
    yield added
    peak = _listed_bytes(_STATUS, "VmHWM")
    if before is not None and peak is not None:
        added.megabytes = max(0.0, peak - before) / 1e6


def _listed_bytes(file: Path, name: str) -> float | None:
    """Return a size, in bytes, that a file of /proc lists in kB; None if it does not."""
    try:
        text = file.read_text("utf-8")
    except OSError:
        return None
    found = re.search(rf"^{name}:\s+(\d+) kB$", text, re.MULTILINE)
    return int(found[1]) * 1024.0 if found else None


def _container(name: str) -> float:
    """Return a size from the container's control group; infinite if there is none or no limit."""
    try:
        return float(Path(f"/sys/fs/cgroup/memory.{name}").read_text("ascii"))
    except (OSError, ValueError):  # no container, or "max"
        return math.inf
