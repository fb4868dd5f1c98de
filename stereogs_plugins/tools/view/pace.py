"""How large pictures may be so that looking around stays fluid."""

from __future__ import annotations

import math

QUICK_SECONDS = 0.08
"""What a picture may take while the visitor moves."""
SHARP_SECONDS = 0.8
"""What it may take once the visitor stands still."""
_FEWEST = 120 * 160
"""Pixels that are always drawn."""
_FIRST_GUESS = 2e6
"""Pixels a second, before one picture has been timed."""
_MEMORY = 0.5
"""Weight of what was measured before."""


class Pace:
    """Chooses sizes by how long the last pictures took."""

    def __init__(self) -> None:
        self._pixels_per_second = _FIRST_GUESS

    def size(self, width: int, height: int, seconds: float) -> tuple[int, int]:
        """The largest size of the window's shape, and no larger, that is likely drawn in that time."""
        pixels = max(_FEWEST, self._pixels_per_second * seconds)
        factor = min(1.0, math.sqrt(pixels / (width * height)))
        return max(1, round(width * factor)), max(1, round(height * factor))

    def took(self, pixels: int, seconds: float) -> None:
        """Learn from a picture."""
        now = pixels / max(seconds, 1e-6)
        self._pixels_per_second = _MEMORY * self._pixels_per_second + (1 - _MEMORY) * now
