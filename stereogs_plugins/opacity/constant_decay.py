"""`constant_decay`: every Gaussian loses a fixed part of its opacity each time (Binocular3DGS, 2024).

Only what the photographs keep asking for stays opaque; floaters near the cameras fade and are pruned.
"""

from __future__ import annotations

from pydantic import Field

from registry import OpacityPolicy, OpacityUpdate, Register, Settings, Step, hookimpl


class ConstantDecaySettings(Settings):
    factor: float = Field(0.995, gt=0, le=1)
    """What the opacities are multiplied by in each iteration that it is due."""


class ConstantDecay(OpacityPolicy[ConstantDecaySettings]):
    """alpha <- factor * alpha; the optimizer's moments stay as they are."""

    # 3DGS resets every 3,000 of 30,000 iterations, in their first half.
    ablation_baseline = "{use: opacity_reset, every: 10%, stop: 49.9%}"

    def update(self, step: Step) -> OpacityUpdate:
        """Return the decayed opacities."""
        return OpacityUpdate(self.settings.factor * step.model.opacities())


@hookimpl
def stereogs_register_opacity_policies(register: Register[ConstantDecay]) -> None:
    register("constant_decay", ConstantDecay)
