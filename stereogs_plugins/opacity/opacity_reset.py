"""`opacity_reset`: now and then all Gaussians become nearly transparent (3DGS, Kerbl et al. 2023).

Those that matter recover their opacity from the photographs; the others stay faint and are pruned.
3DGS does it every 3,000 iterations, and before a white background once more when densification begins.
"""

from __future__ import annotations

from pydantic import Field

from registry import OpacityPolicy, OpacityUpdate, Register, Settings, Step, hookimpl


class OpacityResetSettings(Settings):
    ceiling: float = Field(0.01, gt=0, lt=1)
    """No opacity is higher than this after a reset."""
    recovery: int = Field(500, ge=0)
    """Iterations that opacities need to grow back; with fewer left before the end nothing is reset."""
    only_on_white: bool = False
    """Reset only in scenes with a white background, as 3DGS does once, at iteration 500."""


class OpacityReset(OpacityPolicy[OpacityResetSettings]):
    """alpha <- min(alpha, ceiling); the optimizer forgets the opacities' moments."""

    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the lowered opacities, or None where nothing is to be reset."""
        if self.settings.only_on_white and min(step.scene.background) < 1:
            return None
        if step.iterations - step.iteration < self.settings.recovery:
            return None
        opacities = step.model.opacities().clamp(max=self.settings.ceiling)
        return OpacityUpdate(opacities, reset_moments=True)


@hookimpl
def stereogs_register_opacity_policies(register: Register[OpacityReset]) -> None:
    register("opacity_reset", OpacityReset)
