"""A model for those who may look and not touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device
from ..gaussians import Gaussians
from ..rendering import Rendering

if TYPE_CHECKING:
    from .model import GaussianModel


class ModelReader:
    """Everything about a `GaussianModel` that can be read, and nothing that changes it.

    It follows the model: each call answers for the Gaussians as they are then. Every tensor is a copy
    of its own, to keep or to change.
    """

    def __init__(self, model: GaussianModel) -> None:
        self._model = model

    @property
    def count(self) -> int:
        """How many Gaussians there are, N."""
        return self._model.count

    @property
    def device(self) -> Device:
        """Where they live."""
        return self._model.device

    @property
    def sh_degree(self) -> int:
        """The SH degree that they have room for, 0 to 3."""
        return self._model.sh_degree

    def read(self, name: str) -> Tensor:
        """One parameter.

        Args:
            name: "means" `[N, 3]`, "log_scales" `[N, 3]`, "quaternions" `[N, 4]`, "opacity_logits"
                `[N]` or "sh" `[N, K, 3]`.

        Raises:
            GaussianError: there is no such parameter.
        """
        return self._model.read(name).clone()

    def gradient(self, name: str) -> Tensor:
        """The gradient of one parameter, in the shape of `read`, after a backward pass."""
        return self._model.gradient(name).clone()

    def parameter(self, name: str) -> Tensor:
        """One parameter in autograd, for losses on parameters; see `GaussianModel.parameter`."""
        return self._model.parameter(name)

    def opacities(self) -> Tensor:
        """Activated opacities `[N]` in (0, 1)."""
        return self._model.opacities()

    def scales(self) -> Tensor:
        """Activated scales `[N, 3]`: standard deviations, world units."""
        return self._model.scales()

    def screen_gradient(self) -> Tensor:
        """Mean NDC norm of the screen-space gradient, `[N]`; see `GaussianModel.screen_gradient`."""
        return self._model.screen_gradient()

    def absolute_screen_gradient(self) -> Tensor:
        """The same without cancellation, `[N]`; see `GaussianModel.absolute_screen_gradient`."""
        return self._model.absolute_screen_gradient()

    def touched(self) -> Tensor:
        """Which Gaussians touched a pixel, bool `[N]`; see `GaussianModel.touched`."""
        return self._model.touched()

    def render(self, camera: Camera, *, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Rendering:
        """A camera as it would be scored: without gradients, colours in [0, 1].

        Args:
            background: behind the Gaussians, three numbers in [0, 1].
        """
        with torch.no_grad():
            rendering = self._model.render(camera, background=background)

        def image(name: str) -> Tensor:
            return rendering.rgb.clamp(0, 1) if name == "rgb" else getattr(rendering, name)

        return Rendering.lazy(image)

    def gaussians(self) -> Gaussians:
        """A copy of all of them on the host."""
        return self._model.gaussians()

    def digest(self) -> str:
        """SHA-256 of all parameters, as hexadecimal: equal digests mean equal bits."""
        return self._model.digest()
