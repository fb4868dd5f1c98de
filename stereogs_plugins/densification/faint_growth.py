"""`faint_growth`: new Gaussians that nobody sees yet, for `relocation` to put to use (3DGS-MCMC).

Kheradmand et al. 2024 let the number of Gaussians grow by a twentieth each time, up to a limit, which
is the pipeline's `training.max_gaussians`. Their new ones are copies that share opacity and size with
what they copy: the same as adding invisible ones and relocating them in the same iteration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from core_rasterizer import Edit

FAINTEST = 1e-6
"""The lowest opacity that the host keeps."""


class FaintGrowthSettings(Settings):
    share: float = Field(0.05, gt=0, allow_inf_nan=False)
    """How many Gaussians are added, as a part of those that there are."""


class FaintGrowth(Densification[FaintGrowthSettings]):
    """Adds invisible copies of Gaussians; what is to become of them, another policy says."""

    def refine(self, step: Step) -> Edit | None:
        """Return the additions; None where the share is less than one Gaussian."""
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
