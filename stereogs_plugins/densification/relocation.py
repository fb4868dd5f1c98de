"""`relocation`: move dead Gaussians to opaque ones (3DGS-MCMC, Kheradmand et al. 2024).

No Gaussian is cloned, split or pruned: a faded one becomes a copy of one drawn by opacity. The two share
its opacity and size so that the picture stays nearly the same (equation 9).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, HostDefaults, Percent, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from core_rasterizer import Edit


class RelocationSettings(Settings):
    dead_opacity: float = Field(0.005, ge=0, lt=1)
    """Gaussians with at most this opacity are dead."""


class DeadRelocation(Densification[RelocationSettings]):
    """Makes each dead Gaussian a copy of a living one, drawn in proportion to its opacity."""

    host_defaults = HostDefaults(start=Percent(2), stop=Percent(83.3), every=100, phase=0)

    def refine(self, step: Step) -> Edit | None:
        """Return the relocation; None if none or all are dead. Logs the number of moves."""
        import torch

        from core_rasterizer import Edit, Relocation

        opacities = step.model.opacities()
        alive = opacities > self.settings.dead_opacity
        dead = (~alive).nonzero()[:, 0]
        step.log(f"{self.context.name}_moved", len(dead) if alive.any() else 0)
        if not len(dead) or not alive.any():
            return None
        chances = opacities.where(alive, 0.0)
        source = torch.multinomial(chances, len(dead), replacement=True, generator=self.generator)
        return Edit(relocate=Relocation(source, dead))


@hookimpl
def stereogs_register_densifications(register: Register[DeadRelocation]) -> None:
    register("relocation", DeadRelocation)
