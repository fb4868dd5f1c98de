"""How much memory this process took at most."""

from __future__ import annotations

import sys


def peak_memory_mb() -> float | None:
    """The largest resident set so far, in megabytes of 10^6 bytes; None where nobody counts it."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Linux counts in KiB, macOS in bytes.
    return float(peak if sys.platform == "darwin" else peak * 1024) / 1e6
