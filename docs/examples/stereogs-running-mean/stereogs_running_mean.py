"""`running_mean`: hold Gaussians to the running mean of their positions, opacities and scales."""

from collections.abc import Mapping

import torch
from pydantic import Field
from torch import Tensor

from stereogs.api import Context, Register, Regularizer, Settings, Step, hookimpl

NAMES = ("means", "opacities", "scales")


class RunningMeanSettings(Settings):
    momentum: float = Field(0.95, ge=0, lt=1)
    """How much of the mean each call leaves as it was."""


class RunningMean(Regularizer[RunningMeanSettings]):
    """Mean squared distance of positions, opacities and scales from their running means."""

    def __init__(self, settings: RunningMeanSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._means: dict[str, Tensor] = {}

    def loss(self, step: Step) -> Tensor:
        terms = []
        for name in NAMES:
            now = step.parameter(name)
            here = now.detach()
            before = self._means.get(name, here)
            before = torch.where(before.isinf(), here, before)  # a new one starts at its position
            self._means[name] = mean = here.lerp(before, self.settings.momentum)
            unit = 1.0 if name == "opacities" else step.extent
            terms.append(((now - mean) / unit).square().mean())
        return torch.stack(terms).sum()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        for name, mean in self._means.items():
            self._means[name] = mean[source]
            self._means[name][fresh] = torch.inf

    def state(self) -> dict[str, Tensor]:
        return dict(self._means)

    def restore(self, state: Mapping[str, Tensor]) -> None:
        self._means = dict(state)


@hookimpl
def stereogs_register_regularizers(register: Register[RunningMean]) -> None:
    register("running_mean", RunningMean)
