"""Parameter gradients: those of renders, on the device, and those of losses on parameters."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..device import Device, DeviceArray
from ..errors import GaussianError
from ..gaussians import undefined_places
from ..layout import ROWS_BEFORE_SH
from ..raster import Block, Renderer
from ..raster.frame import Lease

_ALL_BANDS = 3


@dataclass(frozen=True, eq=False)
class Unprojected:
    """A backward pass up to the (tile, Gaussian) pairs; the rest waits until it is known who reads it.

    Args:
        sums: of the pairs, valid until the renderer's next backward pass.
        statistics: array that the rest adds to, or None.
        detach: parameters without gradient.
    """

    renderer: Renderer
    lease: Lease
    block: Block
    sums: DeviceArray
    statistics: DeviceArray | None
    detach: frozenset[str]

    @property
    def bands(self) -> int:
        """Degree of the SH bands that have a gradient."""
        return self.lease.frame.request.bands

    def write(self, gradients: DeviceArray, accumulate: bool) -> None:
        """Write the gradients of the parameters."""
        self.renderer.project_backward(
            self.lease.frame,
            self.block,
            self.sums,
            gradients,
            accumulate,
            self.statistics,
            self.detach,
        )

    def step(self, **arguments: DeviceArray | float) -> None:
        """Use the gradients for a step of Adam, without writing them; its kernel arguments by name."""
        self.renderer.project_backward_and_step(
            self.lease.frame, self.block, self.sums, self.statistics, self.detach, **arguments
        )


class Gradients:
    """Gradient rows `[rows, capacity]` that are zeroed at no cost and written when they are read.

    Renders write their gradients on the device. Gradients of losses on parameters wait on the host until
    `settle`, so that `of_renders` shows which Gaussians the renders touched. Sums have a fixed order:
    renders in autograd's order, then the others.

    The last stage of a render's backward pass waits (`Unprojected`). If nothing reads its gradients, the
    optimizer uses them without storing them.

    Attributes:
        writes: number of backward passes that have written here.
    """

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: torch.dtype) -> None:
        self._rows = DeviceArray(device, shape, dtype)
        self._unprojected: Unprojected | None = None
        self._used = False
        self.writes = 0
        self._forgotten = False
        self._written_degree = 0
        self._waiting: dict[tuple[int, int], Tensor] = {}

    @property
    def rows(self) -> DeviceArray:
        """`[rows, capacity]` on the device.

        Raises:
            GaussianError: a step of the optimizer has used the gradients.
        """
        self.complete()
        if self._used:
            raise GaussianError(
                "the gradients are gone: the optimizer's step used them without storing them",
                field="gradients",
                fix="read them before the step, in an opacity policy or a densification",
            )
        return self._rows

    def forget(self) -> None:
        """Set all gradients to zero, lazily: the next backward pass overwrites them."""
        if self._unprojected is not None and self._unprojected.statistics is not None:
            self.complete()
        self._unprojected, self._used = None, False
        self._forgotten = True
        self._waiting.clear()

    def defer(self, unprojected: Unprojected) -> None:
        """Take over a backward pass whose last stage may wait."""
        self.complete()
        self._used = False
        self.writes += 1
        self._unprojected = unprojected

    def complete(self) -> None:
        """Finish a waiting backward pass. Call this before its inputs change."""
        waiting, self._unprojected = self._unprojected, None
        if waiting is not None:
            waiting.write(self._rows, self.make_ready(waiting.bands))
            self._written(waiting.bands)

    def take(self) -> Unprojected | None:
        """Take the waiting backward pass if all gradients come from it, else return None."""
        if not self._forgotten or self._waiting:
            return None
        waiting, self._unprojected = self._unprojected, None
        return waiting

    def give_up(self) -> None:
        """Forget all gradients; reading them raises until the next backward pass or `forget`."""
        self.forget()
        self._used = True

    def make_ready(self, sh_degree: int) -> bool:
        """Prepare for a backward pass that writes SH bands up to a degree; call `written` after it.

        Returns:
            True if the pass must add to the rows, False if it must overwrite them.
        """
        self.complete()
        self._used = False
        if self._forgotten and sh_degree < self._written_degree:
            self._rows.fill(0)  # bands that this pass does not overwrite hold older values
        # Adding needs valid rows; bands above the degree written so far hold zeros.
        return not self._forgotten

    def written(self, sh_degree: int) -> None:
        """Record that a backward pass has written SH bands up to a degree."""
        self.writes += 1
        self._written(sh_degree)

    def _written(self, sh_degree: int) -> None:
        before = 0 if self._forgotten else self._written_degree
        self._written_degree = max(sh_degree, before)
        self._forgotten = False

    def of_renders(self, first: int, last: int | None) -> Tensor:
        """Rows `[first, last)` of the renders' gradients."""
        rows = self.rows
        self._write_pending_zeros()
        return rows.read(first, last)

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
        self._used = False
        rows = (first, first + values.shape[0])
        if rows not in self._waiting:
            self._waiting[rows] = torch.zeros(
                values.shape[0], self._rows.shape[1], dtype=self._rows.dtype
            )
        self._waiting[rows][:, : values.shape[1]] += values

    def settle(self) -> None:
        """Update `rows` with pending zeros and gradients, for an optimizer on the device."""
        gradients = self.rows
        self._write_pending_zeros()
        for rows, values in self._waiting.items():
            gradients.write(gradients.read(*rows) + values, *rows)
            if rows[0] == ROWS_BEFORE_SH:
                self._written_degree = _ALL_BANDS
        self._waiting.clear()

    def _write_pending_zeros(self) -> None:
        if self._forgotten:
            self._rows.fill(0)
            self._written_degree = 0
            self._forgotten = False
