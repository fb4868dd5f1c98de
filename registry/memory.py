"""How much memory this process took at most."""

from __future__ import annotations

import re
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def peak_memory_mb() -> float | None:
    """The largest resident set so far, in megabytes of 10^6 bytes; None where nobody counts it."""
    if _STATUS.exists():
        # Linux. getrusage would start from the peak of whoever started this process.
        peak = re.search(r"^VmHWM:\s+(\d+) kB$", _STATUS.read_text("utf-8"), re.MULTILINE)
        return int(peak[1]) * 1024 / 1e6 if peak else None
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak_usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts in bytes, others in KiB.
    return float(peak_usage if sys.platform == "darwin" else peak_usage * 1024) / 1e6
