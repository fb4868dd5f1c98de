"""Arrays on a device; where memory is shared they are torch tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
import torch
from numpy.typing import NDArray
from torch import Tensor

from .host_pool import host_pool
from .memory import DeviceMemory

_NUMPY_TYPES: dict[torch.dtype, np.dtype[Any]] = {
    torch.float32: np.dtype(np.float32),
    torch.float64: np.dtype(np.float64),
    torch.int32: np.dtype(np.int32),
    torch.int64: np.dtype(np.int64),
    torch.uint8: np.dtype(np.uint8),
    torch.uint16: np.dtype(np.uint16),
}


class DeviceArray:
    """A contiguous array on a device.

    On a device that shares memory the array is backed by a torch tensor, and `read` and `write` need
    no extra copy; elsewhere they copy, counted by `DeviceMemory.bytes_moved`.

    Args:
        shape: of the array; dimensions may be zero.
        dtype: float32, float64, int32, int64, uint8 or uint16.
        over: CPU tensor to wrap instead of allocating; only where memory is shared.
        zeroed: whether it begins with zeros; otherwise the caller writes all elements.
    """

    def __init__(
        self,
        device: DeviceMemory,
        shape: tuple[int, ...],
        dtype: torch.dtype = torch.float32,
        *,
        over: Tensor | None = None,
        zeroed: bool = True,
    ) -> None:
        self.device = device
        self.shape = shape
        self.dtype = dtype
        # OpenCL has no empty buffers.
        self._elements = max(1, math.prod(shape))
        self.buffer, self._host = device.allocate(self._elements, dtype, over)
        self._copy: tuple[Tensor, NDArray[Any]] | None = None
        if self._host is None and zeroed:
            self.fill(0)

    @classmethod
    def holding(cls, device: DeviceMemory, values: Tensor) -> DeviceArray:
        """Return an array of these values, without waiting for the device.

        Args:
            values: contiguous CPU tensor; the caller must not write to it again.
        """
        shared = device.shares_memory
        over = values if shared else None
        array = cls(device, tuple(values.shape), values.dtype, over=over, zeroed=False)
        if not shared:
            array.hand_over(values)
        return array

    @classmethod
    def for_results(cls, device: DeviceMemory, elements: int, dtype: torch.dtype) -> DeviceArray:
        """Return an array that a kernel fills; where memory is shared, in memory that is used again."""
        over = host_pool.empty((elements,), dtype) if device.shares_memory else None
        return cls(device, (elements,), dtype, over=over, zeroed=False)

    def __del__(self) -> None:
        host: Tensor | None = getattr(self, "_host", None)
        if host is not None:
            self.device.retired.add(host)

    @property
    def nbytes(self) -> int:
        """Size of the elements in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def writes_through_torch(self) -> int:
        """Number of in-place writes through the shared tensor; 0 where no tensor shares the memory."""
        if self._host is None or self._host.is_inference():
            return 0
        return self._host._version

    def read(self, first: int = 0, last: int | None = None) -> Tensor:
        """Wait for the device and return rows `[first, last)`; by default all.

        Where memory is shared this is a view that later kernels change; elsewhere a copy.
        """
        shape, begin, end = self._rows(first, last)
        if self._host is not None:
            mapped, _ = self._enqueue_map(cl.map_flags.READ)
            try:
                self.device.finish()
            finally:
                mapped.base.release()
            return self._host[begin:end].reshape(shape)
        result = torch.empty(shape, dtype=self.dtype)
        if result.numel():
            offset = begin * self.dtype.itemsize
            with self.device.retired.drained():
                cl.enqueue_copy(self.device.queue, result.numpy(), self.buffer, src_offset=offset)
            self.device.bytes_moved += result.nbytes
        return result

    def write(self, values: Tensor, first: int = 0, last: int | None = None) -> None:
        """Replace rows `[first, last)` by `values` of the same shape, converted to the array's type."""
        shape, begin, end = self._rows(first, last)
        values = values.detach().to("cpu", self.dtype).reshape(shape).contiguous()
        if not values.numel():
            return
        if self._host is not None:
            with self._mapped(cl.map_flags.WRITE):
                self._host[begin:end].copy_(values.reshape(-1))
        else:
            offset = begin * self.dtype.itemsize
            with self.device.retired.drained():
                cl.enqueue_copy(self.device.queue, self.buffer, values.numpy(), dst_offset=offset)
            self.device.bytes_moved += values.nbytes

    def hand_over(self, values: Tensor, first: int = 0) -> None:
        """Replace rows from `first` on, without waiting where memory is not shared.

        Args:
            values: contiguous CPU tensor of the array's type; the caller must not write to it again.
        """
        if self._host is not None:
            self.write(values, first, first + len(values))
            return
        _, offset, _ = self._rows(first, None)
        event = cl.enqueue_copy(
            self.device.queue,
            self.buffer,
            values.numpy(),
            dst_offset=offset * self.dtype.itemsize,
            is_blocking=False,
        )
        # The event holds the memory of `values`.
        self.device.retired.copy_enqueued(event)
        self.device.bytes_moved += values.nbytes

    def fill(self, value: int, first: int = 0, last: int | None = None) -> None:
        """Set every element of rows `[first, last)` to `value`; by default all."""
        _, begin, end = self._rows(first, last)
        if self._host is not None:
            with self._mapped(cl.map_flags.WRITE):
                self._host[begin:end] = value
        elif begin < end:
            pattern = np.array(value, dtype=_NUMPY_TYPES[self.dtype])
            begin, end = begin * self.dtype.itemsize, end * self.dtype.itemsize
            cl.enqueue_fill_buffer(self.device.queue, self.buffer, pattern, begin, end - begin)

    def begin_reading(self) -> Callable[[], Tensor]:
        """Enqueue a read of the contents as left by the work enqueued so far.

        Returns:
            A function that waits for this read, not for work enqueued later, and returns the contents
            like `read`, in memory that the next call of `begin_reading` uses again.
        """
        mapped: Any = None
        if self._host is not None:
            host = self._host.reshape(self.shape)
            mapped, event = self._enqueue_map(cl.map_flags.READ)
        else:
            if self._copy is None:
                empty = torch.empty(self.shape, dtype=self.dtype)
                self._copy = empty, empty.numpy()
            host, memory = self._copy
            event = cl.enqueue_copy(self.device.queue, memory, self.buffer, is_blocking=False)
            self.device.bytes_moved += memory.nbytes
        self.device.queue.flush()

        def result() -> Tensor:
            nonlocal mapped
            event.wait()
            if mapped is not None:
                mapped.base.release()
                mapped = None
            return host

        return result

    def _rows(self, first: int, last: int | None) -> tuple[tuple[int, ...], int, int]:
        """Shape of a range of rows, and its first and last (exclusive) element."""
        last = self.shape[0] if last is None else last
        row = math.prod(self.shape[1:])
        return (last - first, *self.shape[1:]), first * row, last * row

    @contextmanager
    def _mapped(self, flags: Any) -> Iterator[None]:
        """Make the host's view current, and the device's afterwards; OpenCL guarantees neither otherwise."""
        mapped, _ = self._enqueue_map(flags)
        self.device.finish()
        try:
            yield
        finally:
            mapped.base.release()

    def _enqueue_map(self, flags: Any) -> tuple[Any, Any]:
        """Enqueue a map without waiting, which costs half of a blocking map.

        Returns:
            The mapped array, whose `base` must be released after the event and not before, and the event.
        """
        shape, dtype = (self._elements,), _NUMPY_TYPES[self.dtype]
        mapped, event = cl.enqueue_map_buffer(
            self.device.queue, self.buffer, flags, 0, shape, dtype, is_blocking=False
        )
        return mapped, event


class Scratch:
    """Named arrays that are reused; each is as large as its largest use so far, with undefined contents."""

    def __init__(self, device: DeviceMemory) -> None:
        self._device = device
        self._arrays: dict[str, DeviceArray] = {}

    def __getitem__(self, name: str) -> DeviceArray:
        return self._arrays[name]

    def named(self, *names: str) -> dict[str, DeviceArray]:
        """The arrays of these names, for a launch."""
        return {name: self._arrays[name] for name in names}

    @property
    def all(self) -> tuple[DeviceArray, ...]:
        """All arrays."""
        return tuple(self._arrays.values())

    def __setitem__(self, name: str, array: DeviceArray) -> None:
        self._arrays[name] = array

    def give_away(self, *names: str) -> None:
        """Forget arrays whose ownership passes to the caller."""
        for name in names:
            self._arrays.pop(name, None)

    def reserve(self, name: str, dtype: torch.dtype, elements: int) -> DeviceArray:
        """Return an array of at least `elements` elements; it grows with a margin, so rarely."""
        array = self._arrays.get(name)
        if array is None or array.shape[0] < elements:
            margin = elements // 8 if array is not None else 0
            array = self._arrays[name] = DeviceArray(self._device, (elements + margin,), dtype)
        return array

    def for_results(self, name: str, dtype: torch.dtype, elements: int) -> DeviceArray:
        """`reserve` for results that may become tensors; see `DeviceArray.for_results`."""
        array = self._arrays.get(name)
        if array is None or array.shape[0] < elements:
            array = DeviceArray.for_results(self._device, elements, dtype)
            self._arrays[name] = array
        return array
