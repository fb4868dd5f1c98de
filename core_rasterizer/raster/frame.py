"""What a render leaves for its backward pass, and how that memory is used again."""

from __future__ import annotations

import weakref

from ..device import Device, Scratch
from .coverage import Coverage
from .request import RenderRequest


class Frame:
    """What the backward pass needs of one render; its arrays are reused by later renders."""

    def __init__(self, device: Device) -> None:
        self.arrays = Scratch(device)
        self.request: RenderRequest
        self.tiles = (0, 0)
        self.pair_limit = 0
        self.visible = 0
        self.pairs = 0
        self._coverage: weakref.ref[Coverage] | None = None

    def coverage(self, count: int) -> Coverage:
        """Which of so many Gaussians the render shows; right for as long as somebody keeps it."""
        coverage = Coverage(self.arrays["slot_count"], count)
        self._coverage = weakref.ref(coverage)
        return coverage

    def leave_coverage(self) -> None:
        """Before the frame is used again: who still keeps the last render's coverage gets the array."""
        if self._coverage is not None and self._coverage() is not None:
            self.arrays.give_away("slot_count")
        self._coverage = None


class Lease:
    """Holds a frame and hands it back to the pool when nobody needs the render any more."""

    def __init__(self, pool: list[Frame], device: Device) -> None:
        self._pool = pool
        self.frame = pool.pop() if pool else Frame(device)
        self.frame.leave_coverage()

    def __del__(self) -> None:
        self._pool.append(self.frame)
