"""Device copies of tensors that do not change on the host, such as photographs."""

from __future__ import annotations

import weakref
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass

import torch
from torch import Tensor

from .array import DeviceArray
from .memory import DeviceMemory

SHARE = 8
"""Copies may use 1/SHARE of a device's memory; the least recently used are dropped first."""


@dataclass(frozen=True)
class _Copy:
    reference: weakref.ref[Tensor]
    version: int
    memory: int
    array: DeviceArray

    def is_of(self, tensor: Tensor, dtype: torch.dtype) -> bool:
        """Whether this is an up-to-date copy of the tensor."""
        return (
            self.reference() is tensor
            and self.version == tensor._version
            and self.memory == tensor.data_ptr()
            and self.array.dtype == dtype
        )


class Uploads:
    """Copies a tensor to the device once, until the tensor is freed or written to.

    Where memory is shared, tensors of the device's type are wrapped instead. Writes are detected by torch's
    version counter; writes through numpy or `.data` into a copied tensor are not detected.
    """

    def __init__(self, device: DeviceMemory) -> None:
        self._device = device
        self._copies: OrderedDict[int, _Copy] = OrderedDict()

    def __len__(self) -> int:
        return len(self._copies)

    def of(self, tensor: Tensor, dtype: torch.dtype) -> DeviceArray:
        """Return a read-only array of the tensor's values, converted to `dtype`."""
        if tensor.is_inference():  # has no version counter
            return self._sent(tensor, dtype)
        copies, key = self._copies, id(tensor)
        known = copies.pop(key, None)
        if known is None or not known.is_of(tensor, dtype):
            # The copy is dropped with the tensor, before its id can be reused.
            reference = weakref.ref(tensor, lambda _: copies.pop(key, None))
            array = self._sent(tensor, dtype)
            known = _Copy(reference, tensor._version, tensor.data_ptr(), array)
            self._make_room(array.nbytes)
        copies[key] = known
        return known.array

    def _sent(self, tensor: Tensor, dtype: torch.dtype) -> DeviceArray:
        values = tensor.detach().to("cpu", dtype).contiguous()
        over = values if self._device.shares_memory else None
        array = DeviceArray(self._device, tuple(values.shape), dtype, over=over, zeroed=False)
        if over is None:
            array.write(values)
        return array

    def _make_room(self, wanted: int) -> None:
        most = self._device.memory_bytes // SHARE - wanted
        while self._copies and self._bytes() > most:
            with suppress(KeyError):  # the last one was freed meanwhile
                self._copies.popitem(last=False)

    def _bytes(self) -> int:
        # A tuple, because a tensor that is freed meanwhile drops its copy.
        return sum(copy.array.nbytes for copy in tuple(self._copies.values()))
