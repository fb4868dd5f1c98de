"""`opacity_reset`: periodically clamp all opacities to a small value (3DGS, Kerbl et al. 2023).

Gaussians that the photographs support recover their opacity; the others stay faint and are pruned.
3DGS resets every 3,000 iterations, and on a white background also when densification starts.
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


class OpacityResetSettings(Settings):
    ceiling: float = Field(0.01, gt=0, lt=1)
    """Largest opacity after a reset."""
    recovery: int = Field(500, ge=0)
    """Iterations that opacities need to recover; a reset with fewer iterations left is skipped."""
    only_on_white: bool = False
    """Reset only in scenes with a white background, as 3DGS does once, at iteration 500."""


class OpacityReset(OpacityPolicy[OpacityResetSettings]):
    """alpha <- min(alpha, ceiling); the optimizer's moments of the opacities are reset."""

    host_defaults = HostDefaults(stop=Percent(49.9), every=Percent(10))

    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the lowered opacities, or None if the reset is skipped."""
        if self.settings.only_on_white and min(step.scene.background) < 1:
            return None
        if step.iterations - step.iteration < self.settings.recovery:
            return None
        opacities = step.model.opacities().clamp(max=self.settings.ceiling)
        return OpacityUpdate(opacities, reset_moments=True)


@hookimpl
def stereogs_register_opacity_policies(register: Register[OpacityReset]) -> None:
    register("opacity_reset", OpacityReset)
