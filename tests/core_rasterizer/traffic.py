"""Counts transfers between host and device, and work in the device's queue."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pyopencl as cl
import pytest


@dataclass
class Traffic:
    """Transfers and work of a device.

    Attributes:
        uploads, downloads: bytes of each copy from the host to the device, and back, in order.
        kernels: launches by the kernel's name.
        fills: arrays, or rows of them, set to one value on the device.
        waits: number of times that the host waited for the device.
    """

    uploads: list[int] = field(default_factory=list)
    downloads: list[int] = field(default_factory=list)
    kernels: Counter[str] = field(default_factory=Counter)
    fills: int = 0
    waits: int = 0

    @property
    def launches(self) -> int:
        """Kernels of all names."""
        return self.kernels.total()

    def __str__(self) -> str:
        return (
            f"up {self.uploads}, down {self.downloads}, {self.launches} launches, "
            f"{self.fills} fills, {self.waits} waits; {dict(self.kernels)}"
        )


@contextmanager
def counted(patch: pytest.MonkeyPatch) -> Iterator[Traffic]:
    """Count all calls of pyopencl within the block, on any device.

    Mapping is not counted: it copies nothing where memory is shared.
    """
    traffic = Traffic()
    with patch.context() as patched:
        _count_copies(patched, traffic)
        _count_kernels(patched, traffic)
        _count_waits(patched, traffic)
        yield traffic


def _count_copies(patch: pytest.MonkeyPatch, traffic: Traffic) -> None:
    copy, fill = cl.enqueue_copy, cl.enqueue_fill_buffer

    def enqueue_copy(queue: Any, dest: Any, src: Any, **options: Any) -> Any:
        if not isinstance(src, cl.MemoryObject):
            traffic.uploads.append(src.nbytes)
        elif not isinstance(dest, cl.MemoryObject):
            traffic.downloads.append(dest.nbytes)
        traffic.waits += options.get("is_blocking", True)
        return copy(queue, dest, src, **options)

    def enqueue_fill_buffer(*arguments: Any, **options: Any) -> Any:
        traffic.fills += 1
        return fill(*arguments, **options)

    patch.setattr(cl, "enqueue_copy", enqueue_copy)
    patch.setattr(cl, "enqueue_fill_buffer", enqueue_fill_buffer)


def _count_kernels(patch: pytest.MonkeyPatch, traffic: Traffic) -> None:
    call = cl.Kernel.__call__

    def launch(kernel: cl.Kernel, *arguments: Any, **options: Any) -> Any:
        traffic.kernels[kernel.function_name] += 1
        return call(kernel, *arguments, **options)

    again = cl.enqueue_nd_range_kernel

    def launch_again(queue: Any, kernel: cl.Kernel, *sizes: Any) -> Any:
        traffic.kernels[kernel.function_name] += 1
        return again(queue, kernel, *sizes)

    patch.setattr(cl.Kernel, "__call__", launch)
    patch.setattr(cl, "enqueue_nd_range_kernel", launch_again)


def _count_waits(patch: pytest.MonkeyPatch, traffic: Traffic) -> None:
    def counting(original: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def wait(waited: Any) -> Any:
            traffic.waits += 1
            return original(waited)

        return wait

    for owner, name in ((cl.CommandQueue, "finish"), (cl.Event, "wait")):
        patch.setattr(owner, name, counting(getattr(owner, name)))
