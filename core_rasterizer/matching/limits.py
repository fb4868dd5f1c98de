"""What settings of matching may be at most, known without loading torch."""

from __future__ import annotations

LARGEST_PENALTY = 7000
"""Of a jump: eight paths still fit in 16 bits."""
MAX_RADIUS = 16
"""Of a window of rectified matching, pixels."""
MAX_SWEEP_RADIUS = 8
"""Of a window of the plane sweep, pixels."""
MOST_PATCH_SOURCES = 12
"""Source views of PatchMatch."""
