"""`forward_warping`: compare virtual views with warped photographs (MVPGS, Xu et al. 2024).

A photograph with depth from the initializer is warped into a virtual camera; holes are excluded. The authors
fill holes by an inpainting network on LLFF, and exclude them on DTU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, PluginError, Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingView


SHARPNESS = 100.0
"""Weight of a point is exp(-SHARPNESS * depth / nearest depth)."""


class ForwardWarpingSettings(Settings):
    views: VirtualViewKind = "box"
    """Positions of the virtual cameras: in a box or on a sphere around the training cameras, or
    between two neighbours."""
    ssim_weight: float = Field(0.8, ge=0, le=1)
    """Weight of D-SSIM; L1 has 1 minus this."""


class ForwardWarping(Regularizer[ForwardWarpingSettings]):
    """(1 - ssim_weight) L1 + ssim_weight (1 - SSIM) between a render and the warped nearest photograph.

    Holes are white in both.
    """

    host_defaults = HostDefaults(every=3)

    def loss(self, step: Step) -> Tensor:
        """Return the loss at a random camera; 0 if no warped pixel is in its view.

        Raises:
            PluginError: the initializer provides no depth maps.
        """
        import torch

        from core_rasterizer import photometric_loss

        camera = virtual_views.draw(self.settings.views, step.scene, self.generator)
        view = _nearest(step, camera)
        known = step.maps[view.name]
        valid = known.valid if view.trained is None else known.valid & view.trained
        warped, seen = forward_splat(view.camera, view.image, known.depth, valid, camera)
        step.log(f"{self.context.name}_seen", float(seen.float().mean()))
        if not seen.any():
            return torch.zeros(())
        rendered = torch.where(seen[..., None], step.render(camera).rgb, 1.0)
        warped = torch.where(seen[..., None], warped, 1.0)
        weight = self.settings.ssim_weight
        return photometric_loss(rendered, warped, weight, device=step.model.device)


def _nearest(step: Step, camera: Camera) -> TrainingView:
    """Return the training view with a depth map whose camera is nearest."""
    with_depth = [view for view in step.scene.train if view.name in step.maps]
    if not with_depth:
        raise PluginError(
            "the initializer provides no depth maps",
            fix="use one that does, for example consistency_dense with `hand_on_depth: true`",
        )
    return min(with_depth, key=lambda view: float((view.camera.center - camera.center).norm()))


def forward_splat(
    camera: Camera, image: Tensor, depth: Tensor, known: Tensor, target: Camera
) -> tuple[Tensor, Tensor]:
    """Warp an image with known depth into another camera, pixels being points.

    Each point is distributed bilinearly over four pixels; points at the same pixel are averaged, with
    the highest weight for the nearest (softmax splatting, Niklaus and Liu 2020).

    Args:
        image: `[H, W, 3]`.
        depth: `[H, W]` z-depth, world units.
        known: `[H, W]` bool, the pixels to warp.

    Returns:
        `[H', W', 3]` float32 colours, 0 in holes; `[H', W']` bool, False in holes.
    """
    import torch

    u, v = camera.pixel_centers()
    points = camera.unproject(u[known], v[known], depth[known])
    u, v, z = target.project(points)
    colors = image[known].double()
    front = z > 0
    u, v, z, colors = u[front] - 0.5, v[front] - 0.5, z[front], colors[front]
    size = target.height * target.width
    nearest = torch.full((size,), torch.inf, dtype=torch.float64)
    shares = []
    for right in (0, 1):
        for down in (0, 1):
            column, row = u.floor() + right, v.floor() + down
            share = (1 - (u - column).abs()) * (1 - (v - row).abs())
            inside = target.contains(column, row)
            used = inside & (share > 1e-3)
            place = (row * target.width + column)[used].long()
            nearest.scatter_reduce_(0, place, z[used], "amin")
            shares.append((place, share[used], z[used], colors[used]))
    total = torch.zeros(size, 4, dtype=torch.float64)
    for place, share, distance, color in shares:
        weight = share * torch.exp(-SHARPNESS * (distance / nearest[place] - 1))
        for channel, values in enumerate((weight, *(weight * c for c in color.unbind(1)))):
            total[:, channel] += torch.bincount(place, values, size)
    hit = total[:, 0] > 0
    picture = torch.where(hit[:, None], total[:, 1:] / total[:, :1].clamp(min=1e-300), 0.0)
    shape = (target.height, target.width)
    return picture.float().reshape(*shape, 3), hit.reshape(shape)
