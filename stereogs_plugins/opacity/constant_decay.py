"""`constant_decay`: multiply all opacities by a constant factor (Binocular3DGS, 2024).

Only Gaussians that the photometric loss supports stay opaque; floaters fade and are pruned.
"""

from __future__ import annotations

from pydantic import Field

from registry import (
    HostDefaults,
    OpacityPolicy,
    OpacityUpdate,
    Percent,
    Register,
    Settings,
    Step,
    hookimpl,
)


class ConstantDecaySettings(Settings):
    factor: float = Field(0.995, gt=0, le=1)
    """Factor of the opacities in each iteration in which the policy is due."""


class ConstantDecay(OpacityPolicy[ConstantDecaySettings]):
    """alpha <- factor * alpha; the optimizer's moments are kept."""

    ablation_baseline = "opacity_reset"
    host_defaults = HostDefaults(start=Percent(1.67))

    def update(self, step: Step) -> OpacityUpdate:
        """Return the decayed opacities."""
        return OpacityUpdate(self.settings.factor * step.model.opacities())


@hookimpl
def stereogs_register_opacity_policies(register: Register[ConstantDecay]) -> None:
    register("constant_decay", ConstantDecay)
