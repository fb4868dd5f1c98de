"""What training, viewing and the wrappers know of an engine: Gaussians, optimizer, loss and edits.

`GaussianModel.engine` implements this in OpenCL. Another engine gives the same meaning to every method; the
docstrings of `GaussianModel`, `Adam`, `photometric_loss` and `apply_edit` define it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device
from ..gaussians import Gaussians
from ..raster import Footprint
from ..rendering import Rendering
from .edit import Carried, Edit


class Statistics(Protocol):
    """Screen-space gradients for densification; see `ScreenStatistics`."""

    def screen_gradient(self) -> Tensor: ...
    def absolute_screen_gradient(self) -> Tensor: ...
    def reset(self) -> None: ...
    def sums(self) -> Tensor: ...
    def restore(self, sums: Tensor) -> None: ...


class Model(Protocol):
    """N Gaussians that render differentiable images; see `GaussianModel`."""

    @property
    def anchor(self) -> Tensor:
        """A scalar leaf that every render and parameter in autograd is computed from."""

    @property
    def statistics(self) -> Statistics:
        """Of the renders that collect them."""

    @property
    def engine(self) -> Engine: ...
    @property
    def count(self) -> int: ...
    @property
    def sh_degree(self) -> int: ...
    @property
    def footprint(self) -> Footprint: ...
    @property
    def backward_passes(self) -> int:
        """Number of backward passes that have written gradients."""

    def read(self, name: str) -> Tensor: ...
    def write(self, name: str, values: Tensor) -> None: ...
    def gradient(self, name: str) -> Tensor: ...
    def gradient_of_renders(self, group: str) -> Tensor:
        """The gradient of a group of `PARAMETER_GROUPS` from renders only, `[rows, N]`."""

    def zero_gradients(self) -> None: ...
    def parameter(self, name: str) -> Tensor: ...
    def opacities(self) -> Tensor: ...
    def scales(self) -> Tensor: ...
    def touched(self) -> Tensor: ...
    def gaussians(self) -> Gaussians: ...
    def digest(self) -> str: ...
    def render(
        self,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        sh_degree: float | None = None,
        opacity_scale: Tensor | None = None,
        smoothing: Tensor | None = None,
        collect_statistics: bool = False,
        collect_absolute: bool = False,
        detach: Collection[str] = (),
    ) -> Rendering: ...


class Optimizer(Protocol):
    """Adam for the parameters of a model; see `Adam`."""

    def step(
        self,
        learning_rates: Mapping[str, float],
        active_sh_degree: float,
        *,
        skip: Collection[str] = (),
        keep_gradients: bool = True,
    ) -> None: ...
    def check_parameters(self) -> None: ...
    def reset_moments(self, name: str) -> None: ...
    def state(self) -> dict[str, Tensor]: ...
    def restore(self, state: Mapping[str, Tensor]) -> None: ...


class Engine(Protocol):
    """Makes models and what belongs to them. Models and optimizers of different engines do not mix.

    Attributes:
        name: for provenance.json.
        device: OpenCL device, for everything else in a run that computes on one.
    """

    @property
    def name(self) -> str: ...
    @property
    def device(self) -> Device: ...
    @property
    def absolute_gradients(self) -> bool:
        """Whether renders collect absolute screen gradients (`collect_absolute`)."""

    def model(
        self, gaussians: Gaussians, *, dilation: float, compensate_dilation: bool
    ) -> Model: ...
    def optimizer(self, model: Any) -> Optimizer: ...
    def loss(
        self, image: Tensor | Rendering, target: Tensor, ssim_weight: float, l1_weight: float | None
    ) -> Tensor: ...
    def edit(
        self, model: Any, optimizer: Any, edit: Edit, generator: torch.Generator
    ) -> Carried: ...
