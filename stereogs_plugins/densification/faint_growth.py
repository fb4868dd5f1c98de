"""`faint_growth`: add invisible Gaussians, which `relocation` then moves (3DGS-MCMC).

Kheradmand et al. 2024 grow the number of Gaussians by 5 % each time, up to a limit, here
`training.max_gaussians`. Their new Gaussians are copies that share opacity and size with their source,
which is the same as adding invisible ones and relocating them in the same iteration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, HostDefaults, Percent, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from core_rasterizer import Edit

FAINTEST = 1e-6
"""The lowest opacity that the host allows."""


class FaintGrowthSettings(Settings):
    share: float = Field(0.05, gt=0, allow_inf_nan=False)
    """Number of added Gaussians, as a share of the current number."""


class FaintGrowth(Densification[FaintGrowthSettings]):
    """Adds invisible copies of Gaussians, for another policy to use."""

    host_defaults = HostDefaults(start=Percent(2), stop=Percent(83.3), every=100, phase=0)

    def refine(self, step: Step) -> Edit | None:
        """Return the additions; None if the share is less than one Gaussian."""
        import torch

        from core_rasterizer import Edit, Gaussians

        count = step.model.count
        added = int(count * (1 + self.settings.share)) - count
        if not added:
            return None
        parents = torch.arange(added) % count
        known = {name: rows[parents] for name, rows in vars(step.model.gaussians()).items()}
        faint = torch.full((added,), FAINTEST).logit()
        return Edit(add=Gaussians(**known | {"opacity_logits": faint}), parents=parents)


@hookimpl
def stereogs_register_densifications(register: Register[FaintGrowth]) -> None:
    register("faint_growth", FaintGrowth)
