"""`unseen_pruning`: remove Gaussians that no photograph can judge (DNGaussian, Li et al. 2024).

What no training view sees is never corrected; what stands right before a camera hides the scene from
views beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, PluginError, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit


class UnseenPruningSettings(Settings):
    near: float = Field(0.0, ge=0)
    """Gaussians nearer to a training camera than this go too, in units of the scene's near bound.
    DNGaussian on LLFF: 10 of COLMAP's units, where near is about 16, to the cameras of a video."""


class UnseenPruning(Densification[UnseenPruningSettings]):
    """Prunes what reaches no training image, or has its centre too near to a camera."""

    def refine(self, step: Step) -> Edit:
        """Return what is to be pruned.

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
                "no Gaussian would be left: none is in a training view and far enough from its camera",
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
