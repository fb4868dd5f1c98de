"""Parameter gradients: those of renders, on the device, and those of losses on parameters."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

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
class DeferredPass:
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


class State(Enum):
    """Where the sum of the renders' gradients is; see `Gradients`."""

    ZERO = "zero: the rows hold older values, which the next pass overwrites"
    STORED = "in the rows"
    DEFERRED = "in a pass that has not been written; the rows are as in ZERO"
    DEFERRED_MORE = "in the rows and in a pass that has not been added to them"
    USED = "gone: a step of the optimizer used them without storing them"


class Gradients:
    """Gradient rows `[rows, capacity]` that are zeroed at no cost and written when they are read.

    The last stage of a render's backward pass is deferred. If nothing reads its gradients, the optimizer
    uses them without storing them. The states of the renders' gradients:

        any state --zero--> ZERO          any state --mark_used--> USED (like ZERO, but reading raises)

        ZERO or USED --defer--> DEFERRED --store_deferred--> STORED --defer--> DEFERRED_MORE
                                   |                         ^    ^                 |
                                   | take_deferred           |    `-store_deferred--'
                                   v                         |
                                  ZERO --end_pass or store---'

    An iteration that nobody observes is ZERO, DEFERRED, ZERO, USED. Another `defer` or a read begins with
    `store_deferred`; a pass that is not deferred is between `begin_pass` and `end_pass`.

    Gradients of losses on parameters wait on the host until `store`, so that `of_renders` shows which
    Gaussians the renders touched; the first after USED leads to ZERO. Sums have a fixed order: renders in
    autograd's order, then the others.

    Attributes:
        state: of the renders' gradients.
        passes: number of backward passes so far.
    """

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: torch.dtype) -> None:
        self._rows = DeviceArray(device, shape, dtype)
        self._rows_degree = 0
        """SH bands above it are zero in the rows, whatever the state."""
        self._deferred: DeferredPass | None = None
        self._of_losses: dict[tuple[int, int], Tensor] = {}
        self.state = State.STORED
        self.passes = 0

    @property
    def rows(self) -> DeviceArray:
        """`[rows, capacity]` on the device.

        Raises:
            GaussianError: a step of the optimizer has used the gradients.
        """
        self.store_deferred()
        if self.state is State.USED:
            raise GaussianError(
                "the gradients are gone: the optimizer's step used them without storing them",
                field="gradients",
                fix="read them before the step, in an opacity policy or a densification",
            )
        return self._rows

    def zero(self) -> None:
        """Set all gradients to zero, lazily: the next backward pass overwrites them."""
        if self._deferred is not None and self._deferred.statistics is not None:
            self.store_deferred()  # for the statistics
        self._deferred = None
        self._of_losses.clear()
        self.state = State.ZERO

    def defer(self, deferred: DeferredPass) -> None:
        """Take over a backward pass whose last stage may wait."""
        self.store_deferred()
        self.passes += 1
        self._deferred = deferred
        stored = self.state is State.STORED
        self.state = State.DEFERRED_MORE if stored else State.DEFERRED

    def store_deferred(self) -> None:
        """Finish a deferred backward pass. Call this before its inputs change."""
        deferred, self._deferred = self._deferred, None
        if deferred is not None:
            more = self.state is State.DEFERRED_MORE
            self.state = State.STORED if more else State.ZERO
            deferred.write(self._rows, self._prepare_rows(deferred.bands))
            self._note_written(deferred.bands)

    def take_deferred(self) -> DeferredPass | None:
        """Take the deferred backward pass if all gradients come from it, else return None."""
        if self.state is not State.DEFERRED or self._of_losses:
            return None
        deferred, self._deferred = self._deferred, None
        self.state = State.ZERO
        return deferred

    def mark_used(self) -> None:
        """Drop all gradients; reading them raises until the next backward pass or `zero`."""
        self.zero()
        self.state = State.USED

    def begin_pass(self, sh_degree: int) -> bool:
        """Prepare for a backward pass that writes SH bands up to a degree; call `end_pass` after it.

        Returns:
            True if the pass must add to the rows, False if it must overwrite them.
        """
        self.store_deferred()
        if self.state is State.USED:
            self.state = State.ZERO
        return self._prepare_rows(sh_degree)

    def end_pass(self, sh_degree: int) -> None:
        """Record that a backward pass has written SH bands up to a degree."""
        self.passes += 1
        self._note_written(sh_degree)

    def _prepare_rows(self, sh_degree: int) -> bool:
        zero = self.state is State.ZERO
        if zero and sh_degree < self._rows_degree:
            self._rows.fill(0)  # bands that the pass does not overwrite hold older values
        # Adding needs valid rows; bands above the degree written so far hold zeros.
        return not zero

    def _note_written(self, sh_degree: int) -> None:
        before = 0 if self.state is State.ZERO else self._rows_degree
        self._rows_degree = max(sh_degree, before)
        self.state = State.STORED

    def of_renders(self, first: int, last: int | None) -> Tensor:
        """Rows `[first, last)` of the renders' gradients."""
        rows = self.rows
        self._store_zeros()
        return rows.read(first, last)

    def total(self, first: int, last: int) -> Tensor:
        """Rows `[first, last)` of all gradients."""
        values = self.of_renders(first, last)
        of_losses = self._of_losses.get((first, last))
        return values if of_losses is None else values + of_losses

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
        self.passes += 1
        if self.state is State.USED:
            self.state = State.ZERO
        rows = (first, first + values.shape[0])
        if rows not in self._of_losses:
            self._of_losses[rows] = torch.zeros(
                values.shape[0], self._rows.shape[1], dtype=self._rows.dtype
            )
        self._of_losses[rows][:, : values.shape[1]] += values

    def store(self) -> None:
        """Write all gradients to `rows`, for an optimizer on the device."""
        gradients = self.rows
        self._store_zeros()
        for rows, values in self._of_losses.items():
            gradients.write(gradients.read(*rows) + values, *rows)
            if rows[0] == ROWS_BEFORE_SH:
                self._rows_degree = _ALL_BANDS
        self._of_losses.clear()

    def _store_zeros(self) -> None:
        if self.state is State.ZERO:
            self._rows.fill(0)
            self._rows_degree = 0
            self.state = State.STORED
