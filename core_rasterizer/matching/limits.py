"""Limits of matching settings; importing them does not load torch."""

from __future__ import annotations

MAX_PENALTY = 7000
"""Penalty of a jump; the sum of eight paths fits in 16 bits."""
MAX_RADIUS = 16
"""Radius of the windows of rectified matching, pixels."""
MAX_SWEEP_RADIUS = 8
"""Radius of the windows of the plane sweep, pixels."""
MAX_PATCH_SOURCES = 12
"""Number of source views of PatchMatch."""
