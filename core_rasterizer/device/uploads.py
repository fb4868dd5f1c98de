"""Copies on a device of what does not change on the host, such as photographs."""

from __future__ import annotations

import weakref
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .array import DeviceArray

if TYPE_CHECKING:
    from .device import Device

SHARE = 8
"""Copies may take this part of a device's memory, one in so many; those longest unused go first."""


@dataclass(frozen=True)
class _Copy:
    reference: weakref.ref[Tensor]
    version: int
    array: DeviceArray

    def is_of(self, tensor: Tensor, dtype: torch.dtype) -> bool:
        """Whether it is a copy of this tensor as it is now."""
        return (
            self.reference() is tensor
            and self.version == tensor._version
            and self.array.dtype == dtype
        )


class Uploads:
    """Sends a tensor once for as long as it lives and is not written to.

    Where memory is shared nothing is sent or kept. torch counts the writes; one past torch, through
    numpy or `.data`, goes unnoticed.

    Args:
        device: whose memory the copies take.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._copies: OrderedDict[int, _Copy] = OrderedDict()

    def __len__(self) -> int:
        return len(self._copies)

    def of(self, tensor: Tensor, dtype: torch.dtype) -> DeviceArray:
        """The tensor's values on the device, converted to `dtype`; not to be written to."""
        values = tensor.detach().to("cpu", dtype).contiguous()
        if self._device.shares_memory:
            return DeviceArray(self._device, tuple(values.shape), dtype, over=values)
        if tensor.is_inference():  # torch does not count the writes into these
            return self._sent(values)
        copies, key = self._copies, id(tensor)
        known = copies.pop(key, None)
        if known is None or not known.is_of(tensor, dtype):
            # The copy goes with the tensor, before another one is given the same address.
            reference = weakref.ref(tensor, lambda _: copies.pop(key, None))
            known = _Copy(reference, tensor._version, self._sent(values))
        copies[key] = known
        self._make_room()
        return known.array

    def _sent(self, values: Tensor) -> DeviceArray:
        copy = DeviceArray(self._device, tuple(values.shape), values.dtype)
        copy.write(values)
        return copy

    def _make_room(self) -> None:
        most = self._device.memory_bytes // SHARE
        while (
            len(self._copies) > 1
            and sum(copy.array.nbytes for copy in self._copies.values()) > most
        ):
            self._copies.popitem(last=False)
