"""Coverage: which training cameras see the surface in a pixel, and from which angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch.nn.functional import grid_sample, normalize

from registry.confidence import Confidence, Trained

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering
    from registry import TrainingView

SAME_SURFACE = 0.03
"""Largest relative difference of depths at which a training camera sees a point."""
SURFACE_ALPHA = 0.5
"""Least alpha of a pixel that shows a surface; others show what is behind the scene."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What one training view tells about the pixels of a camera.

    Args:
        seen: `[H, W]` bool: the view sees the surface point.
        angle: `[H, W]` degrees between the two rays to the point.
        color: `[H, W, 3]` colour of the photograph there.
    """

    seen: Tensor
    angle: Tensor
    color: Tensor


class CoverageConfidence(Confidence):
    """Which training cameras see each pixel's surface point.

    Args:
        trained: Gaussians and training views.
        angle: see `CoverageSettings`.
    """

    def __init__(self, trained: Trained, angle: float) -> None:
        self._trained, self._angle = trained, angle
        self._depths = [self._depth_of(view.camera)[1] for view in trained.scene.train]

    def _depth_of(self, camera: Camera) -> tuple[Rendering, Tensor]:
        """Return a render, and its z-depth `[H, W]`, infinite where no surface is."""
        scene = self._trained.scene
        rendering = self._trained.model.render(camera, background=scene.background)
        depth = rendering.depth / rendering.alpha.clamp(min=1e-6)
        return rendering, depth.where(rendering.alpha > SURFACE_ALPHA, torch.inf)

    def seen_by(self, camera: Camera) -> tuple[Rendering, list[Seen]]:
        """Return the render of a camera, and what each training view tells about its pixels."""
        rendering, depth = self._depth_of(camera)
        surface = depth.isfinite()
        far = 10 * self._trained.scene.bounds[1]
        u, v = camera.pixel_centers()
        points = camera.unproject(u, v, depth.where(surface, far)).float()
        ray = normalize(points - camera.center.float(), dim=2)
        pairs = zip(self._trained.scene.train, self._depths, strict=True)
        return rendering, [_seen(points, ray, surface, view, known) for view, known in pairs]

    def weights(self, views: list[Seen]) -> Tensor:
        """Return `[V, H, W]` in [0, 1]: how much each view counts, the most first."""
        return torch.stack([self.weight(view) for view in views]).sort(0, descending=True).values

    def weight(self, view: Seen) -> Tensor:
        """Return `[H, W]` in [0, 1]: how much a view counts."""
        return torch.exp(-view.angle / self._angle) * view.seen

    def of(self, camera: Camera) -> Tensor:
        """Return the mean weight of the two best views: one shows a colour, a second confirms its depth."""
        weights = self.weights(self.seen_by(camera)[1])[:2]
        return weights.sum(dim=0) / 2


def _seen(points: Tensor, ray: Tensor, surface: Tensor, view: TrainingView, depth: Tensor) -> Seen:
    """Project `points` `[H, W, 3]`, seen along unit vectors `ray`, into a view with z-depths `depth`."""
    u, v, z = view.camera.project(points)
    inside = view.camera.contains(u, v, z)
    row = v.clamp(0, view.camera.height - 1).nan_to_num(0).long()
    column = u.clamp(0, view.camera.width - 1).nan_to_num(0).long()
    if view.trained is not None:
        inside &= view.trained[row, column]
    there = depth[row, column]
    same = torch.where(surface, (there - z).abs() <= SAME_SURFACE * z, there.isinf())
    own = normalize(points - view.camera.center.float(), dim=2)
    angle = (own * ray).sum(dim=2).clamp(-1, 1).arccos().rad2deg()
    size = torch.tensor([view.camera.width, view.camera.height])
    places = (torch.stack([u, v], dim=2) / size * 2 - 1).float().nan_to_num(0)
    image = view.image.permute(2, 0, 1)[None]
    color = grid_sample(image, places[None], align_corners=False, padding_mode="border")[0]
    return Seen(inside & same, angle, color.permute(1, 2, 0))
