"""`dropout`: drop random Gaussians in each training render (DropGaussian, 2025; StereoGS).

The remaining Gaussians must explain the photograph, so that occluded ones receive gradients too. The starred
rows of StereoGS use a fixed rate of 0.3; DropGaussian increases it to 0.2 over the run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Modifier, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class DropoutSettings(Settings):
    rate: float = Field(0.3, ge=0, lt=1)
    """Share of the Gaussians that a training render drops."""
    ramp: bool = False
    """Increase the rate linearly from 0 to `rate` over the run."""
    compensate: bool = True
    """Multiply the opacities of the kept Gaussians by 1 / (1 - rate)."""


class Dropout(Modifier[DropoutSettings]):
    """Opacity factors of 0 for a random share, 1 or 1 / (1 - rate) for the rest.

    The share is a multiple of 2^-16.
    """

    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors."""
        import numpy as np
        import torch

        count, rate = step.model.count, self.settings.rate
        if self.settings.ramp:
            rate *= step.iteration / step.iterations
        # 16 random bits for each Gaussian take a third of the time of `torch.rand`.
        pairs = torch.empty(-(-count // 2), dtype=torch.int32)
        pairs.random_(-(2**31), None, generator=self.generator)
        drawn = pairs.numpy().view(np.uint16)[:count]
        keep = torch.from_numpy((drawn >= round(2**16 * rate)).astype(np.float32))
        return keep / (1 - rate) if self.settings.compensate else keep


@hookimpl
def stereogs_register_modifiers(register: Register[Dropout]) -> None:
    register("dropout", Dropout)
