"""`idle_fade`: Gaussians that reach no training view for long lose opacity, until they are pruned.

It keeps a count per Gaussian, which checkpoints save (`state`, `restore`) and edits rearrange (`carry`).
"""

from collections.abc import Mapping

import torch
from pydantic import Field
from torch import Tensor

from stereogs import api

STEREOGS_API = 1
"""Version of the plugin API that this module was written for."""


class IdleFadeSettings(api.Settings):
    patience: int = Field(50, ge=0)
    """Number of consecutive updates without a touched pixel before a Gaussian fades."""
    factor: float = Field(0.95, gt=0, le=1)
    """Factor applied to its opacity at each update from then on."""


class IdleFade(api.OpacityPolicy[IdleFadeSettings]):
    """Decay of Gaussians that have not touched a pixel recently."""

    def __init__(self, settings: IdleFadeSettings, context: api.Context) -> None:
        super().__init__(settings, context)
        self._idle = torch.zeros(0, dtype=torch.int64)

    def update(self, step: api.Step) -> api.OpacityUpdate:
        """Return the new opacities."""
        if not len(self._idle):
            self._idle = torch.zeros(step.model.count, dtype=torch.int64)
        self._idle = torch.where(step.model.touched(), 0, self._idle + 1)
        fading = self._idle > self.settings.patience
        step.log("fading", float(fading.sum()))
        opacities = step.model.opacities()
        return api.OpacityUpdate(torch.where(fading, self.settings.factor * opacities, opacities))

    def state(self) -> dict[str, Tensor]:
        """Return the consecutive updates without a touched pixel, `[N]` int64; empty at first."""
        return {"idle": self._idle}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore the counts that `state` returned."""
        self._idle = state["idle"].clone()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Keep the counts of remaining Gaussians; new ones start at 0."""
        if len(self._idle):
            self._idle = torch.where(fresh, 0, self._idle[source])


@api.hookimpl
def stereogs_register_opacity_policies(register: api.Register[IdleFade]) -> None:
    register("idle_fade", IdleFade)
