"""A device that detects accesses outside buffers."""

from __future__ import annotations

import sys

import numpy as np
import pyopencl as cl
import torch
from torch import Tensor

from core_rasterizer import Device
from tests.core_rasterizer.quick_device import QuickDevice

ZONE = 1 << 14
"""Bytes before and after every buffer; also a multiple of any device's address alignment."""
PATTERNS = (0xFF, 0x7F)
"""Read as numbers: NaN and -1 or 2^32 - 1; 3e38 (1e306 in double) and two thousand million."""


class GuardedDevice(QuickDevice):
    """A device on which every buffer lies between two zones of one known byte.

    What a kernel writes outside its buffers changes a zone, which `check` finds. What it reads there
    is a NaN or a huge integer, or with the other pattern another number, so that results differ.
    """

    def __init__(self, original: Device, pattern: int) -> None:
        super().__init__(original, original.variant, original.shares_memory, everything=True)
        self._pattern = pattern
        self._parts: list[tuple[cl.Buffer, cl.Buffer]] = []

    def allocate(
        self, elements: int, dtype: torch.dtype, over: Tensor | None
    ) -> tuple[cl.Buffer, Tensor | None]:
        """The part between two zones of a larger buffer, which is kept for `check`."""
        size = elements * dtype.itemsize
        whole = torch.full((ZONE + size + ZONE,), self._pattern, dtype=torch.uint8)
        inside = whole[ZONE : ZONE + size].view(dtype)
        inside.copy_(torch.zeros(elements, dtype=dtype) if over is None else over.reshape(-1))
        flags: int = cl.mem_flags.READ_WRITE
        flags |= cl.mem_flags.USE_HOST_PTR if self.shares_memory else cl.mem_flags.COPY_HOST_PTR
        buffer = cl.Buffer(self.context, flags, hostbuf=whole.numpy())
        part = buffer.get_sub_region(ZONE, size)
        self._parts.append((buffer, part))
        return part, inside if self.shares_memory else None

    def check(self) -> int:
        """Raise if a zone was written to; return the number of buffers checked."""
        self.finish()
        for number, (buffer, _) in enumerate(self._parts):
            content = np.empty(buffer.size, dtype=np.uint8)
            cl.enqueue_copy(self.queue, content, buffer)
            for side, zone in (("before", content[:ZONE]), ("after", content[-ZONE:])):
                changed = np.flatnonzero(zone != self._pattern)
                if len(changed):
                    raise AssertionError(
                        f"{len(changed)} bytes {side} buffer {number} of {buffer.size - 2 * ZONE} "
                        f"bytes were overwritten, the first at {changed[0]} of {ZONE}"
                    )
        checked = len(self._parts)
        # Two references, the list's and the argument's: no array uses the part any more.
        self._parts = [pair for pair in self._parts if sys.getrefcount(pair[1]) > 2]
        return checked
