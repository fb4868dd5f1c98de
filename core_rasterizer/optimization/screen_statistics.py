"""How strongly renders pull at the Gaussians on the image, summed on the device for densification."""

from __future__ import annotations

import torch
from torch import Tensor

from ..device import Device, DeviceArray
from ..errors import GaussianError


class ScreenStatistics:
    """Sums over the renders that are collected: norms of screen-space gradients, and times seen.

    Args:
        device: where the sums live.
        count: Gaussians, N.
        capacity: columns of the sums, at least N.
        dtype: torch.float32 or torch.float64.
    """

    def __init__(self, device: Device, count: int, capacity: int, dtype: torch.dtype) -> None:
        self._count = count
        self._sums = DeviceArray(device, (2, capacity), dtype)

    def mean(self) -> Tensor:
        """See `GaussianModel.screen_gradient`."""
        sums = self._read()
        return sums[0] / sums[1].clamp(min=1)

    def absolute_mean(self) -> Tensor:
        """See `GaussianModel.absolute_screen_gradient`."""
        sums = self._read()
        if len(sums) < 3:
            raise GaussianError(
                "no render has collected absolute screen gradients",
                field="means",
                fix="render with collect_absolute=True; a policy says so with `absolute_gradients`",
            )
        return sums[2] / sums[1].clamp(min=1)

    def reset(self) -> None:
        """Start counting anew."""
        self._sums.fill(0)

    def sums(self) -> Tensor:
        """A copy of what means are made of; see `GaussianModel.statistics`."""
        return self._read().clone()

    def restore(self, sums: Tensor) -> None:
        """Take back what `sums` returned."""
        old = self._sums
        full = torch.zeros(len(sums), old.shape[1], dtype=old.dtype)
        full[:, : self._count] = sums
        self._sums = DeviceArray(old.device, tuple(full.shape), old.dtype)
        self._sums.write(full)

    def rows(self, absolute: bool) -> DeviceArray:
        """Where a backward pass adds; with a row for absolute gradients from the first on.

        Args:
            absolute: whether that pass collects absolute gradients.
        """
        wanted = 3 if absolute else 2
        if self._sums.shape[0] != wanted:
            before = self._read()
            self.restore(torch.cat([before, torch.zeros(1, self._count)])[:wanted])
        return self._sums

    def _read(self) -> Tensor:
        return self._sums.read()[:, : self._count]
