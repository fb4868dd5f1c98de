"""Memory that kernels under way may still use when nobody else does any more."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch import Tensor


class Retired:
    """Keeps host memory alive until the kernels that may use it have run.

    OpenCL does not keep a buffer's host memory alive. Waiting for the queue whenever an array dies would
    do, but several die in an iteration, and each wait would hold up what could be enqueued meanwhile.
    """

    def __init__(self) -> None:
        self._enqueued = self._completed = 0
        self._kept: list[object] = []

    def __len__(self) -> int:
        return len(self._kept)

    def kernel_enqueued(self) -> None:
        """To be said after a kernel was enqueued, while its arguments are still held."""
        self._enqueued += 1

    def copy_enqueued(self, source: object) -> None:
        """Take over what holds the memory that a copy under way reads from."""
        self._enqueued += 1
        self._kept.append(source)

    def add(self, memory: Tensor) -> None:
        """Take over the last reference to the memory of an array."""
        if self._enqueued > self._completed:
            self._kept.append(memory)

    @contextmanager
    def drained(self) -> Iterator[None]:
        """Around a wait for everything enqueued so far; what was retired before is let go after it."""
        enqueued = self._enqueued
        before, self._kept = self._kept, []
        try:
            yield
        except BaseException:
            self._kept += before
            raise
        self._completed = max(self._completed, enqueued)
