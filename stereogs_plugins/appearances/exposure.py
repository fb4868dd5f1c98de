"""`exposure`: each photograph has a brightness and white balance of its own (Hierarchical 3DGS, 2024).

Where a camera chose its exposure anew for every photograph, Gaussians have to explain the difference by
colours that depend on the direction, or by haze. Here each training view has an affine map of colours, the
identity at first and trained along. The mean of the maps over the views is held at the identity: test views
are rendered without one, in the brightness that the photographs have on average.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Appearance, ParameterGroup, Register, Settings, Step, TrainingScene, hookimpl
from registry.toolkit.views import ViewParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor


class ExposureSettings(Settings):
    learning_rate: float = Field(1e-3, ge=0, allow_inf_nan=False)
    """Adam's step size of the maps' twelve numbers; colours lie in [0, 1]."""


class Exposure(Appearance[ExposureSettings]):
    """rgb <- (I + A) rgb + b, with A `[3, 3]` and b `[3]` of the iteration's view."""

    def begin_training(self, scene: TrainingScene) -> None:
        """Give every training view a map."""
        self._maps = ViewParameters(scene, (3, 4))

    def parameters(self) -> Sequence[ParameterGroup]:
        """The views' (A | b), `[3, 4]` each."""
        return [self._maps.group("maps", self.settings.learning_rate)]

    def colors(self, step: Step, rgb: Tensor) -> Tensor:
        """Return `[H, W, 3]` colours as the view's photograph would show them.

        Logs the mean gain, 1 at the identity.
        """
        change = self._maps.of(step.view)
        step.log(f"{self.context.name}_gain", 1 + float(change.detach()[:, :3].sum()) / 3)
        change = change.to(rgb.dtype)
        return rgb + rgb @ change[:, :3].T + change[:, 3]


@hookimpl
def stereogs_register_appearances(register: Register[Exposure]) -> None:
    register("exposure", Exposure)
