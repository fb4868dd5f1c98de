"""Host memory of images that is used again: new memory costs a page fault for every 4 KB."""

from __future__ import annotations

import math
import weakref
from threading import Lock

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

SMALLEST = 1 << 16
"""Bytes below which the allocator itself keeps memory."""
KEPT = 8
"""Blocks that wait to be used again; a training iteration needs four or five."""
ALIGNMENT = 4096
"""Bytes. Some drivers copy host memory that does not begin with a page."""


class HostPool:
    """Uninitialized CPU tensors whose memory returns here when the last tensor that shares it is freed."""

    def __init__(self) -> None:
        self._free: list[NDArray[np.uint8]] = []
        self._lock = Lock()

    def empty(self, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
        """Like `torch.empty`."""
        size = math.prod(shape) * dtype.itemsize
        if size < SMALLEST:
            return torch.empty(shape, dtype=dtype)
        block = self._taken(size)
        # torch holds this view as long as any tensor uses the memory.
        view = block[:]
        weakref.finalize(view, self._give_back, block).atexit = False
        return torch.from_numpy(view).view(dtype).reshape(shape)

    def _taken(self, size: int) -> NDArray[np.uint8]:
        with self._lock:
            # Tensors may be freed at any moment, also here; they then return to the new list.
            found, self._free = self._free, []
            for index, block in enumerate(found):
                if block.nbytes == size:
                    self._free += found[:index] + found[index + 1 :]
                    return block
            self._free += found
        whole = np.empty(size + ALIGNMENT, dtype=np.uint8)
        first = -whole.ctypes.data % ALIGNMENT
        return whole[first : first + size]

    def _give_back(self, block: NDArray[np.uint8]) -> None:
        self._free.append(block)
        del self._free[:-KEPT]


host_pool = HostPool()
"""Of this process."""
