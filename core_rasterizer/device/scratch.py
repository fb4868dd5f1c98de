"""Arrays that outlive the work that they were made for, so that the next finds them."""

from __future__ import annotations

import torch

from .array import DeviceArray
from .device import Device


class Scratch:
    """Arrays by name, each as large as the largest use so far; what they hold is left from it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._arrays: dict[str, DeviceArray] = {}

    def __getitem__(self, name: str) -> DeviceArray:
        return self._arrays[name]

    def __setitem__(self, name: str, array: DeviceArray) -> None:
        self._arrays[name] = array

    def give_away(self, *names: str) -> None:
        """Forget arrays, which are from now on somebody else's."""
        for name in names:
            self._arrays.pop(name, None)

    def reserve(self, name: str, dtype: torch.dtype, elements: int) -> DeviceArray:
        """An array of at least so many elements; grown with a margin, so that growth is rare."""
        array = self._arrays.get(name)
        if array is None or array.shape[0] < elements:
            margin = elements // 8 if array is not None else 0
            array = self._arrays[name] = DeviceArray(self._device, (elements + margin,), dtype)
        return array
