"""`forward_warping`: photographs, moved to where none was taken, are looked at there (MVPGS, Xu et al. 2024).

A photograph whose depth the initializer knows is warped into a virtual camera; what it does not show
there stays out. The authors fill such holes by an inpainting network on LLFF, and leave them out on DTU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import PluginError, Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

from .warp import forward_splat

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingView


class ForwardWarpingSettings(Settings):
    views: VirtualViewKind = "box"
    """Where the virtual camera of each iteration stands: in a box or on a sphere around the training
    cameras, or between two neighbours."""
    ssim_weight: float = Field(0.8, ge=0, le=1)
    """Share of D-SSIM beside L1."""


class ForwardWarping(Regularizer[ForwardWarpingSettings]):
    """(1 - ssim_weight) L1 + ssim_weight (1 - SSIM) between a render and the nearest photograph, warped.

    Holes are white in both.
    """

    def loss(self, step: Step) -> Tensor:
        """The term at a camera drawn for this iteration; 0 if nothing warped is in its view.

        Raises:
            PluginError: the initializer handed no depth maps on.
        """
        import torch

        from core_rasterizer import photometric_loss

        camera = virtual_views.draw(self.settings.views, step.scene, self.generator)
        view = _nearest(step, camera)
        known = step.maps[view.name]
        warped, seen = forward_splat(view.camera, view.image, known.depth, known.valid, camera)
        step.log(f"{self.context.name}_seen", float(seen.float().mean()))
        if not seen.any():
            return torch.zeros(())
        rendered = torch.where(seen[..., None], step.render(camera).rgb, 1.0)
        warped = torch.where(seen[..., None], warped, 1.0)
        weight = self.settings.ssim_weight
        return photometric_loss(rendered, warped, weight, device=step.model.device)


def _nearest(step: Step, camera: Camera) -> TrainingView:
    """The training view with a depth map whose camera is nearest."""
    able = [view for view in step.scene.train if view.name in step.maps]
    if not able:
        raise PluginError(
            "the initializer has handed no depth maps on",
            fix="use one that does, for example consistency_dense with `hand_on_depth: true`",
        )
    return min(able, key=lambda view: float((view.camera.center - camera.center).norm()))
