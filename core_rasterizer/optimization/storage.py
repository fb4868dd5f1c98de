"""Gaussians on a device: parameter rows, their gradients, and statistics for densification."""

from __future__ import annotations

import torch
from torch import Tensor

from ..device import Device, DeviceArray
from ..errors import GaussianError
from ..gaussians import undefined_places
from ..layout import PARAMETER_GROUPS, PARAMETERS, row_count, rows_of
from ..raster import Block, unpack
from .gradients import Gradients
from .screen_statistics import ScreenStatistics


class GaussianStorage:
    """N Gaussians on a device.

    Args:
        parameters: `[rows, capacity]`, see `layout`.
        count: N; columns from N on are padding.

    Attributes:
        parameters: `[rows, capacity]` on the device.
        gradients: of the parameters.
        statistics: screen-space gradients of the renders that collect them.
        steps: number of steps of optimizers so far.
    """

    def __init__(
        self, device: Device, dtype: torch.dtype, sh_degree: int, parameters: Tensor, count: int
    ) -> None:
        self.device, self.dtype, self.sh_degree, self.steps = device, dtype, sh_degree, 0
        self.adopt(parameters, count)

    def adopt(self, parameters: Tensor | DeviceArray, count: int) -> None:
        """Replace the parameters `[rows, capacity]`; reset gradients and statistics."""
        if isinstance(parameters, Tensor):
            array = DeviceArray(self.device, tuple(parameters.shape), self.dtype)
            array.write(parameters)
            parameters = array
        gradients = Gradients(self.device, parameters.shape, self.dtype)
        self.statistics = ScreenStatistics(
            self.device, count, parameters.shape[1], self.dtype, gradients.store_deferred
        )
        self.gradients = gradients
        self.parameters = parameters
        self.count = count

    @property
    def rows(self) -> int:
        """Number of scalar parameters of one Gaussian."""
        return row_count(self.sh_degree)

    @property
    def capacity(self) -> int:
        """Number of columns of `parameters`: `count`, padded."""
        return self.parameters.shape[1]

    @property
    def block(self) -> Block:
        """The parameters as input of a `Renderer`."""
        return Block(self.parameters, self.count, activated=False)

    def read(self, name: str) -> Tensor:
        """Return one parameter; where memory is shared, a view that later steps change.

        Args:
            name: "means" `[N, 3]`, "log_scales" `[N, 3]`, "quaternions" `[N, 4]`, "opacity_logits"
                `[N]` or "sh" `[N, K, 3]`.

        Raises:
            GaussianError: unknown name.
        """
        return self._unpack(self.parameters.read(*self.rows_of(name)), name)

    def write(self, name: str, values: Tensor) -> None:
        """Replace one parameter; `values` has the shape that `read` returns.

        Raises:
            GaussianError: the shape differs, or a value is not finite.
        """
        first, last = self.rows_of(name)
        expected = tuple(self._unpack(torch.empty(last - first, self.count), name).shape)
        if tuple(values.shape) != expected:
            raise GaussianError(
                f"the shape is {tuple(values.shape)}, expected {expected}", field=name
            )
        values = values.to(self.dtype).reshape(self.count, last - first)
        undefined = undefined_places(values)
        if len(undefined):
            raise GaussianError("a value is not finite", field=name, index=int(undefined[0, 0]))
        self.gradients.store_deferred()
        updated = torch.zeros(last - first, self.capacity, dtype=self.dtype)
        # torch takes twenty times as long as numpy to copy a transposed array.
        updated.numpy()[:, : self.count] = values.detach().numpy().T
        self.parameters.hand_over(updated, first)

    def gradient(self, name: str) -> Tensor:
        """The gradient of one parameter, summed over the backward passes since `zero_gradients`.

        Raises:
            GaussianError: unknown name; or `Adam.step` was told not to keep gradients.
        """
        return self._unpack(self.gradients.total(*self.rows_of(name)), name)

    def zero_gradients(self) -> None:
        """Reset the gradients at no cost: the next backward pass overwrites them."""
        self.gradients.zero()

    def touched(self) -> Tensor:
        """Which Gaussians contributed to a pixel in the renders since `zero_gradients`, bool `[N]`.

        Valid from the backward pass to the optimizer's step: those with a non-zero gradient of position,
        opacity or constant colour. Opacity alone would miss Gaussians at the largest alpha. Renders that
        detach all three parameters, and losses on parameters, do not count.
        """
        groups = [PARAMETER_GROUPS[name] for name in ("means", "opacity_logits", "sh_constant")]
        gradients = torch.cat([self.gradients.of_renders(*rows) for rows in groups])
        return (gradients[:, : self.count] != 0).any(dim=0)

    def check_unedited(self, parameters: DeviceArray) -> None:
        """Raise if the Gaussians were replaced since the forward pass.

        Args:
            parameters: `self.parameters` at the forward pass.

        Raises:
            GaussianError: they were replaced.
        """
        if parameters is not self.parameters:
            raise GaussianError(
                "Gaussians were added or removed between a render and its backward pass",
                field="means",
                fix="call backward before editing the Gaussians",
            )

    def check_not_stepped(self, steps: int) -> None:
        """Raise if an optimizer has stepped since a render: its gradients would mix old and new values.

        Args:
            steps: `self.steps` at the render.

        Raises:
            GaussianError: it has stepped.
        """
        if steps != self.steps:
            raise GaussianError(
                "the optimizer has stepped between a render and its backward pass",
                field="means",
                fix="render again, or keep `rendering.detach()` between iterations",
            )

    def rows_of(self, name: str) -> tuple[int, int]:
        """Rows `[first, last)` of one parameter.

        Raises:
            GaussianError: unknown name.
        """
        if name not in PARAMETERS:
            raise GaussianError(
                f"unknown parameter {name!r}", field=name, fix=f"use one of {', '.join(PARAMETERS)}"
            )
        return rows_of(name, self.sh_degree)

    def _unpack(self, rows: Tensor, name: str) -> Tensor:
        return unpack(rows, name, self.count)
