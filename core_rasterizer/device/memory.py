"""Context, queue and memory of one OpenCL device."""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import Literal

import pyopencl as cl
import torch
from torch import Tensor

from ..errors import DeviceError, MemoryBudgetError

Kind = Literal["cpu", "gpu", "accelerator"]

_contexts: dict[cl.Device, tuple[cl.Context, cl.CommandQueue]] = {}
"""One context for each device, whatever its variants: a GPU's driver refuses more when many are open."""
_opening = RLock()


class Retired:
    """Keeps host memory alive until the kernels that may use it have run.

    OpenCL does not keep a buffer's host memory alive. Waiting for the queue whenever an array is freed
    would also be safe, but several are freed per iteration and each wait would stall the queue.
    """

    def __init__(self) -> None:
        self._enqueued = self._completed = 0
        self._kept: list[object] = []

    def __len__(self) -> int:
        return len(self._kept)

    def kernel_enqueued(self) -> None:
        """Count kernels. Call this after enqueueing them, while their arguments are still referenced."""
        self._enqueued += 1

    def copy_enqueued(self, source: object) -> None:
        """Count a copy and keep `source`, the owner of the memory that it reads."""
        self._enqueued += 1
        self._kept.append(source)

    def add(self, memory: Tensor) -> None:
        """Take over the last reference to an array's memory."""
        if self._enqueued > self._completed:
            self._kept.append(memory)

    def drained(self) -> _Drained:
        """Wrap a wait for the queue; afterwards release everything retired before it."""
        return _Drained(self)


class _Drained:
    __slots__ = ("_before", "_enqueued", "_retired")

    def __init__(self, retired: Retired) -> None:
        self._retired = retired

    def __enter__(self) -> None:
        retired = self._retired
        self._enqueued, self._before = retired._enqueued, retired._kept
        retired._kept = []

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        retired = self._retired
        if error is not None:
            retired._kept += self._before
        else:
            retired._completed = max(retired._completed, self._enqueued)


class DeviceMemory:
    """An OpenCL device that allocates memory; opened on first use.

    Attributes:
        name, platform, driver: as reported by the driver.
        kind: "cpu", "gpu" or "accelerator".
        memory_bytes: size of the device's memory.
        buffer_bytes: size of the largest buffer that the driver allocates.
        shares_memory: If True, device buffers are host memory, which torch accesses without a copy.
        bytes_moved: Bytes copied between the host and a device that does not share memory.
        lock: held while a kernel is enqueued, and by the owner of scratch memory while it is in use.
        retired: freed memory that enqueued kernels may still use.
    """

    def __init__(self, handle: cl.Device, shares_memory: bool | None) -> None:
        self._handle = handle
        self.name = handle.name.strip()
        self.platform = handle.platform.name.strip()
        self.driver = handle.driver_version.strip()
        self.kind: Kind = _kind_of(handle)
        self.memory_bytes = int(handle.global_mem_size)
        self.buffer_bytes = int(handle.max_mem_alloc_size)
        self.shares_memory = self.kind == "cpu" if shares_memory is None else shares_memory
        self.bytes_moved = 0
        self.lock = RLock()
        self.retired = Retired()

    @cached_property
    def context(self) -> cl.Context:
        """The context, which contains this device only; variants of a device share it, and the queue.

        Raises:
            DeviceError: the driver cannot open the device.
        """
        return self._opened[0]

    @cached_property
    def queue(self) -> cl.CommandQueue:
        """The in-order queue.

        Raises:
            DeviceError: as for `context`.
        """
        return self._opened[1]

    @cached_property
    def _opened(self) -> tuple[cl.Context, cl.CommandQueue]:
        with _opening:
            if self._handle not in _contexts:
                _contexts[self._handle] = self._open_it()
            return _contexts[self._handle]

    def _open_it(self) -> tuple[cl.Context, cl.CommandQueue]:
        try:
            context = cl.Context([self._handle])
            return context, cl.CommandQueue(context)
        except cl.Error as error:
            raise DeviceError(
                f"the device {self.name!r} could not be opened: {error}",
                where=self.platform,
                fix="choose another device; `stereogs doctor` lists them",
            ) from error

    def allocate(
        self, elements: int, dtype: torch.dtype, over: Tensor | None
    ) -> tuple[cl.Buffer, Tensor | None]:
        """Allocate memory for an array.

        Args:
            over: a CPU tensor to wrap instead, where memory is shared.

        Returns:
            A buffer of `elements` elements and, where memory is shared, the flat tensor behind it.

        Raises:
            MemoryBudgetError: the allocation failed, or the driver allows no buffer of this size.
        """
        flags: int = cl.mem_flags.READ_WRITE
        size = elements * dtype.itemsize
        if size > self.buffer_bytes:
            raise MemoryBudgetError(
                f"a buffer of {size / 2**20:,.0f} MB is too large for the device {self.name!r}",
                where=f"its driver allocates at most {self.buffer_bytes / 2**20:,.0f} MB at once",
                fix=f"use {self.buffer_bytes / size:.0%} as many Gaussians or pixels, or another device",
            )
        try:
            if not self.shares_memory:
                return cl.Buffer(self.context, flags, size=size), None
            host = (over if over is not None else torch.zeros(elements, dtype=dtype)).reshape(-1)
            flags |= cl.mem_flags.USE_HOST_PTR
            return cl.Buffer(self.context, flags, hostbuf=host.numpy()), host
        except (cl.Error, RuntimeError) as error:
            raise MemoryBudgetError(
                f"the device {self.name!r} could not allocate {size / 2**20:,.0f} MB: {error}",
                where=f"its memory is {self.memory_bytes / 2**20:,.0f} MB in total",
                fix="use fewer Gaussians or pixels, or free device memory",
            ) from error

    def finish(self) -> None:
        """Wait until all enqueued work has run."""
        with self.retired.drained():
            self.queue.finish()


def _kind_of(handle: cl.Device) -> Kind:
    if handle.type & cl.device_type.CPU:
        return "cpu"
    return "gpu" if handle.type & cl.device_type.GPU else "accelerator"
