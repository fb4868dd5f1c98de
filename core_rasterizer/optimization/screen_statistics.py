"""Screen-space gradients of the Gaussians, summed on the device for densification."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..device import Device, DeviceArray
from ..errors import GaussianError


class ScreenStatistics:
    """Sums over the renders with `collect_statistics` since `reset`.

    Args:
        device: where the sums are stored.
        count: number of Gaussians, N.
        capacity: columns of the sums, >= N.
        dtype: torch.float32 or torch.float64.
        complete: finishes backward passes that will add to the sums; called before these are used.
    """

    def __init__(
        self,
        device: Device,
        count: int,
        capacity: int,
        dtype: torch.dtype,
        complete: Callable[[], None],
    ) -> None:
        self._count, self._complete = count, complete
        self._sums = DeviceArray(device, (2, capacity), dtype)

    def screen_gradient(self) -> Tensor:
        """Mean NDC norm of the screen-space gradient of the mean over the renders that saw it, `[N]`.

        0 for Gaussians never seen. NDC gradients are pixel gradients times half the image width and
        height (3DGS), so published thresholds apply.
        """
        sums = self._read()
        return sums[0] / sums[1].clamp(min=1)

    def absolute_screen_gradient(self) -> Tensor:
        """`screen_gradient` without cancellation between pixels, `[N]` (AbsGS, Ye et al. 2024).

        The absolute values of the pixels' contributions to both components are summed before the norm is
        taken. Collected by renders with `collect_absolute`, averaged over the renders of `screen_gradient`.

        Raises:
            GaussianError: no render has collected it since the Gaussians were created or edited.
        """
        sums = self._read()
        if len(sums) < 3:
            raise GaussianError(
                "no render has collected absolute screen gradients",
                field="means",
                fix="render with collect_absolute=True; a component declares it in `needs_rendered`",
            )
        return sums[2] / sums[1].clamp(min=1)

    def reset(self) -> None:
        """Set all sums to zero."""
        self._complete()
        self._sums.fill(0)

    def sums(self) -> Tensor:
        """A copy of the sums, for checkpoints.

        Returns:
            `[2, N]`: sums of norms and number of renders that saw the Gaussian; `[3, N]` with the sums of
            absolute norms if they are collected.
        """
        return self._read().clone()

    def restore(self, sums: Tensor) -> None:
        """Continue from `sums`."""
        self._complete()
        old = self._sums
        full = torch.zeros(len(sums), old.shape[1], dtype=old.dtype)
        full[:, : self._count] = sums
        self._sums = DeviceArray(old.device, tuple(full.shape), old.dtype)
        self._sums.write(full)

    def rows(self, absolute: bool) -> DeviceArray:
        """The array that a backward pass adds to, with a third row if `absolute`."""
        wanted = 3 if absolute else 2
        if self._sums.shape[0] != wanted:
            before = self._read()
            self.restore(torch.cat([before, torch.zeros(1, self._count)])[:wanted])
        return self._sums

    def _read(self) -> Tensor:
        self._complete()
        return self._sums.read()[:, : self._count]
