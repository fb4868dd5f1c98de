"""`exposure`: a trained exposure and white balance per photograph (Hierarchical 3DGS, 2024).

With automatic exposure, Gaussians explain brightness differences by view-dependent colours or by haze.
Here each training view has a trainable affine map of colours, initially the identity. The mean of the maps
over the views stays the identity: test views are rendered without a map, at the average brightness.
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
    """Adam's learning rate of the maps' twelve parameters; colours are in [0, 1]."""


class Exposure(Appearance[ExposureSettings]):
    """rgb <- (I + A) rgb + b, with A `[3, 3]` and b `[3]` of the iteration's view."""

    def begin_training(self, scene: TrainingScene) -> None:
        """Give every training view a map."""
        self._maps = ViewParameters(scene, (3, 4))

    def parameters(self) -> Sequence[ParameterGroup]:
        """Return the views' (A | b), `[3, 4]` each."""
        return [self._maps.group("maps", self.settings.learning_rate)]

    def colors(self, step: Step, rgb: Tensor) -> Tensor:
        """Return the colours `[H, W, 3]` with the view's exposure.

        Logs the mean gain, 1 for the identity.
        """
        change = self._maps.of(step.view)
        step.log(f"{self.context.name}_gain", 1 + float(change.detach()[:, :3].sum()) / 3)
        change = change.to(rgb.dtype)
        return rgb + rgb @ change[:, :3].T + change[:, 3]


@hookimpl
def stereogs_register_appearances(register: Register[Exposure]) -> None:
    register("exposure", Exposure)
