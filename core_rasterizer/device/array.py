"""Arrays on a device, which are torch tensors where memory is shared."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl
import torch
from torch import Tensor

if TYPE_CHECKING:
    from .device import Device

_NUMPY_TYPES = {
    torch.float32: np.float32,
    torch.float64: np.float64,
    torch.int32: np.int32,
    torch.int64: np.int64,
    torch.uint8: np.uint8,
    torch.uint16: np.uint16,
}


class DeviceArray:
    """A contiguous array on a device.

    On a device that shares memory the array *is* a torch tensor (`tensor`), and `read` and `write`
    cost no copy of their own; elsewhere they move bytes, which `Device.bytes_moved` counts.

    Args:
        shape: of the array; a dimension may be zero.
        dtype: float32, float64, int32, int64, uint8 or uint16.
        over: wrap this CPU tensor instead of allocating; only where memory is shared.
    """

    def __init__(
        self,
        device: Device,
        shape: tuple[int, ...],
        dtype: torch.dtype = torch.float32,
        *,
        over: Tensor | None = None,
    ) -> None:
        self.device = device
        self.shape = shape
        self.dtype = dtype
        # OpenCL has no empty buffers, so an empty array keeps one element in reserve.
        elements = max(1, math.prod(shape))
        self.buffer, self._host = device.allocate(elements, dtype, over)
        if self._host is None:
            self.fill(0)

    def __del__(self) -> None:
        host: Tensor | None = getattr(self, "_host", None)
        if host is not None:
            self.device.retired.add(host)

    @property
    def nbytes(self) -> int:
        """Bytes that the array's elements take."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def writes_through_torch(self) -> int:
        """How often the contents were written to as a tensor; 0 where no tensor shares them."""
        if self._host is None or self._host.is_inference():
            return 0
        return self._host._version

    def read(self, first: int = 0, last: int | None = None) -> Tensor:
        """Wait for the device and return rows `[first, last)` of the contents; by default all.

        Where memory is shared this is a view that later kernels will change; elsewhere a copy.
        """
        shape, begin, end = self._rows(first, last)
        if self._host is not None:
            self._map(cl.map_flags.READ)
            return self._host[begin:end].reshape(shape)
        result = torch.empty(shape, dtype=self.dtype)
        if result.numel():
            offset = begin * self.dtype.itemsize
            with self.device.retired.drained():
                cl.enqueue_copy(self.device.queue, result.numpy(), self.buffer, src_offset=offset)
            self.device.bytes_moved += result.nbytes
        return result

    def write(self, values: Tensor, first: int = 0, last: int | None = None) -> None:
        """Replace rows `[first, last)`; `values` has their shape and is converted to the array's type."""
        shape, begin, end = self._rows(first, last)
        values = values.detach().to("cpu", self.dtype).reshape(shape).contiguous()
        if not values.numel():
            return
        if self._host is not None:
            self._map(cl.map_flags.WRITE)
            self._host[begin:end].copy_(values.reshape(-1))
        else:
            offset = begin * self.dtype.itemsize
            with self.device.retired.drained():
                cl.enqueue_copy(self.device.queue, self.buffer, values.numpy(), dst_offset=offset)
            self.device.bytes_moved += values.nbytes

    def hand_over(self, values: Tensor, first: int = 0) -> None:
        """Replace rows from `first` on without waiting, where memory is not shared.

        Args:
            values: on the CPU, of the array's type, contiguous; nobody may write to it any more.
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
            self._map(cl.map_flags.WRITE)
            self._host[begin:end] = value
        elif begin < end:
            pattern = np.array(value, dtype=_NUMPY_TYPES[self.dtype])
            begin, end = begin * self.dtype.itemsize, end * self.dtype.itemsize
            cl.enqueue_fill_buffer(self.device.queue, self.buffer, pattern, begin, end - begin)

    def begin_reading(self) -> Callable[[], Tensor]:
        """Ask for the contents as they are after what is enqueued so far, without waiting for them.

        Returns:
            What waits until they are there and returns them, as `read` does. What is enqueued
            meanwhile is not waited for.
        """
        if self._host is not None:
            host, event = self._host.reshape(self.shape), self._enqueue_map(cl.map_flags.READ)
        else:
            host = torch.empty(self.shape, dtype=self.dtype)
            event = cl.enqueue_copy(self.device.queue, host.numpy(), self.buffer, is_blocking=False)
            self.device.bytes_moved += host.nbytes

        def result() -> Tensor:
            event.wait()
            return host

        return result

    def _rows(self, first: int, last: int | None) -> tuple[tuple[int, ...], int, int]:
        """Shape of a range of rows, and where its elements begin and end."""
        last = self.shape[0] if last is None else last
        row = math.prod(self.shape[1:])
        return (last - first, *self.shape[1:]), first * row, last * row

    def _map(self, flags: Any) -> None:
        """Make the host's view current; only mapping promises that, though it copies nothing."""
        self._enqueue_map(flags)
        self.device.finish()

    def _enqueue_map(self, flags: Any) -> Any:
        """The same, once the device has finished. It costs half of a call that waits itself.

        Returns:
            The event of it.
        """
        mapped: Any
        elements, dtype = max(1, math.prod(self.shape)), np.dtype(_NUMPY_TYPES[self.dtype])
        mapped, event = cl.enqueue_map_buffer(
            self.device.queue, self.buffer, flags, 0, (elements,), dtype, is_blocking=False
        )
        mapped.base.release()
        return event
