"""`parameter_l1`: L1 penalty on opacities or scales, which fades or shrinks unsupported Gaussians.

3DGS-MCMC (Kheradmand et al. 2024) uses both, each with weight 0.01. Opacities and scales are positive, so
that the mean is an L1 norm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from registry import HostDefaults, Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class ParameterL1Settings(Settings):
    parameter: Literal["opacities", "scales"]
    """Penalized parameter: opacities, or scales in the frame of training (typical depth 8)."""


class ParameterL1(Regularizer[ParameterL1Settings]):
    """mean alpha over the Gaussians, or mean sigma over the Gaussians and their three axes."""

    host_defaults = HostDefaults(weight=0.01)

    def loss(self, step: Step) -> Tensor:
        """Return the mean, in autograd."""
        return step.parameter(self.settings.parameter).mean()


@hookimpl
def stereogs_register_regularizers(register: Register[ParameterL1]) -> None:
    register("parameter_l1", ParameterL1)
