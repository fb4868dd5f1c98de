"""`idle_fade`: Gaussians that no training view has touched for long lose opacity, until they are pruned.

What it keeps for each Gaussian, a count, is saved with checkpoints (`state`, `restore`) and follows every
edit (`carry`).
"""

from collections.abc import Mapping

import torch
from pydantic import Field
from torch import Tensor

import registry

STEREOGS_API = 3
"""The version of the plugin API that this module was written for."""


class IdleFadeSettings(registry.Settings):
    patience: int = Field(50, ge=0)
    """How often in a row a Gaussian may be found untouched before it fades."""
    factor: float = Field(0.95, gt=0, le=1)
    """What its opacity is multiplied by then, each time that the policy is due."""


class IdleFade(registry.OpacityPolicy[IdleFadeSettings]):
    """Lets Gaussians fade that have touched no pixel for a while."""

    def __init__(self, settings: IdleFadeSettings, context: registry.Context) -> None:
        super().__init__(settings, context)
        self._idle = torch.zeros(0, dtype=torch.int64)

    def update(self, step: registry.Step) -> registry.OpacityUpdate:
        """Return the new opacities."""
        if not len(self._idle):
            self._idle = torch.zeros(step.model.count, dtype=torch.int64)
        self._idle = torch.where(step.model.touched(), 0, self._idle + 1)
        fading = self._idle > self.settings.patience
        step.log("fading", float(fading.sum()))
        opacities = step.model.opacities()
        return registry.OpacityUpdate(
            torch.where(fading, self.settings.factor * opacities, opacities)
        )

    def state(self) -> dict[str, Tensor]:
        """How often in a row each Gaussian was found untouched, `[N]` int64; empty at first."""
        return {"idle": self._idle}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self._idle = state["idle"].clone()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Those that stay keep their count; new ones start at 0."""
        if len(self._idle):
            self._idle = torch.where(fresh, 0, self._idle[source])


@registry.hookimpl
def stereogs_register_opacity_policies(register: registry.Register[IdleFade]) -> None:
    register("idle_fade", IdleFade)
