"""`parameter_l1`: the mean opacity or scale, so that what no photograph needs fades or shrinks.

3DGS-MCMC (Kheradmand et al. 2024) has both, with a weight of 0.01 each; as opacities and
scales are positive, the mean is an L1 norm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from registry import Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor


class ParameterL1Settings(Settings):
    parameter: Literal["opacities", "scales"]
    """What is to be small: opacities, or scales in world units."""


class ParameterL1(Regularizer[ParameterL1Settings]):
    """mean alpha over the Gaussians, or mean sigma over the Gaussians and their three axes."""

    def loss(self, step: Step) -> Tensor:
        """The mean, in autograd."""
        return step.parameter(self.settings.parameter).mean()


@hookimpl
def stereogs_register_regularizers(register: Register[ParameterL1]) -> None:
    register("parameter_l1", ParameterL1)
