"""`unseen_pruning`: prune Gaussians that no training view constrains (DNGaussian, Li et al. 2024).

Gaussians outside all training views are never corrected; those close to a camera occlude the scene in
neighbouring views.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import (
    Densification,
    HostDefaults,
    Percent,
    PluginError,
    Register,
    Settings,
    Step,
    hookimpl,
)

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit


class UnseenPruningSettings(Settings):
    near: float = Field(0.0, ge=0)
    """Gaussians nearer to a training camera than this are pruned too, in units of the scene's near bound.
    DNGaussian on LLFF: 10 COLMAP units (near is about 16), to the cameras of a rendered video."""


class UnseenPruning(Densification[UnseenPruningSettings]):
    """Prunes Gaussians that touch no training image, or whose centre is too close to a camera."""

    host_defaults = HostDefaults(every=Percent(16.7))

    def refine(self, step: Step) -> Edit:
        """Return the pruning mask.

        Raises:
            PluginError: no Gaussian would be left.
        """
        import torch

        from core_rasterizer import Edit

        seen = torch.zeros(step.model.count, dtype=torch.bool)
        for view in step.scene.train:
            seen |= step.render(view.camera, gradient=False).visible
        prune = ~seen | self._near(step)
        if prune.all():
            raise PluginError(
                "no Gaussian would be left: none is both in a training view and beyond `near`",
                fix="check the initial points, or lower `near`",
            )
        return Edit(prune=prune)

    def _near(self, step: Step) -> Tensor:
        import torch

        centers = torch.stack([view.camera.center for view in step.scene.train])
        distances = torch.cdist(step.model.read("means").double(), centers)
        return distances.amin(dim=1) < self.settings.near * step.scene.bounds[0]


@hookimpl
def stereogs_register_densifications(register: Register[UnseenPruning]) -> None:
    register("unseen_pruning", UnseenPruning)
