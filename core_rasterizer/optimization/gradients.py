"""Parameter gradients: those of renders, on the device, and those of losses on parameters."""

from __future__ import annotations

import torch
from torch import Tensor

from ..device import Device, DeviceArray
from ..errors import GaussianError
from ..gaussians import undefined_places
from ..layout import ROWS_BEFORE_SH

_ALL_BANDS = 3


class Gradients:
    """Gradient rows `[rows, capacity]` that are zeroed at no cost.

    Renders write their gradients on the device. Gradients of losses on parameters wait on the host until
    `settle`, so that `of_renders` shows which Gaussians the renders touched. Sums have a fixed order:
    renders in autograd's order, then the others.

    Attributes:
        rows: `[rows, capacity]` on the device.
        writes: number of backward passes that have written here.
    """

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: torch.dtype) -> None:
        self.rows = DeviceArray(device, shape, dtype)
        self.writes = 0
        self._forgotten = False
        self._written_degree = 0
        self._waiting: dict[tuple[int, int], Tensor] = {}

    def forget(self) -> None:
        """Set all gradients to zero, lazily: the next backward pass overwrites them."""
        self._forgotten = True
        self._waiting.clear()

    def make_ready(self, sh_degree: int) -> bool:
        """Prepare for a backward pass that writes SH bands up to a degree; call `written` after it.

        Returns:
            True if the pass must add to the rows, False if it must overwrite them.
        """
        if self._forgotten and sh_degree < self._written_degree:
            self.rows.fill(0)  # bands that this pass does not overwrite hold older values
        # Adding needs valid rows; bands above the degree written so far hold zeros.
        return not self._forgotten

    def written(self, sh_degree: int) -> None:
        """Record that a backward pass has written SH bands up to a degree."""
        self.writes += 1
        before = 0 if self._forgotten else self._written_degree
        self._written_degree = max(sh_degree, before)
        self._forgotten = False

    def of_renders(self, first: int, last: int | None) -> Tensor:
        """Rows `[first, last)` of the renders' gradients."""
        self._write_pending_zeros()
        return self.rows.read(first, last)

    def total(self, first: int, last: int) -> Tensor:
        """Rows `[first, last)` of all gradients."""
        values = self.of_renders(first, last)
        waiting = self._waiting.get((first, last))
        return values if waiting is None else values + waiting

    def add(self, name: str, first: int, values: Tensor) -> None:
        """Add the gradient of a loss on a parameter.

        Args:
            name: of the parameter, for the error.
            first: its first row.
            values: `[width, N]`.

        Raises:
            GaussianError: a value is not finite; nothing is added then.
        """
        undefined = undefined_places(values)
        if len(undefined):
            raise GaussianError(
                f"the loss has an undefined gradient in {len(undefined)} values of the parameter "
                f"{name!r}",
                field=name,
                index=int(undefined[:, 1].min()),
                where="backward of a loss on parameters",
                fix="look for a division by zero or a square root of zero in the loss",
            )
        self.writes += 1
        rows = (first, first + values.shape[0])
        if rows not in self._waiting:
            self._waiting[rows] = torch.zeros(
                values.shape[0], self.rows.shape[1], dtype=self.rows.dtype
            )
        self._waiting[rows][:, : values.shape[1]] += values

    def settle(self) -> None:
        """Update `rows` with pending zeros and gradients, for an optimizer on the device."""
        self._write_pending_zeros()
        for rows, values in self._waiting.items():
            self.rows.write(self.rows.read(*rows) + values, *rows)
            if rows[0] == ROWS_BEFORE_SH:
                self._written_degree = _ALL_BANDS
        self._waiting.clear()

    def _write_pending_zeros(self) -> None:
        if self._forgotten:
            self.rows.fill(0)
            self._written_degree = 0
            self._forgotten = False
