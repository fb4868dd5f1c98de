"""`cycle_filtered_warping`: photographs, looked up by rendered depth, where that depth comes full circle.

The appearance loss of ICO-GS (2026, arXiv 2603.02893). A virtual camera near a training camera is
rendered; each of its pixels is looked up in all photographs. It counts in those where the way there and
back, by the depths that are rendered at both ends, returns to nearly the depth that it began with, and
only if at least half of the photographs agree.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Regularizer, Settings, Step

from .warp import look_up

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

SMALLEST_ALPHA = 0.05
"""Below, the Gaussians show too little to have a depth."""


class CycleFilteredWarpingSettings(Settings):
    radius: float = Field(0.1, gt=0)
    """Radius of the sphere round a training camera on which virtual cameras stand, in units of the
    scene's extent; they look its way. The paper's number is not known here."""
    max_depth_error: float = Field(0.01, gt=0)
    """Between a pixel's depth and that of its way back, as a part of the largest depth in the render."""
    agreeing: float = Field(0.5, gt=0, le=1)
    """Share of the training views that must be within it."""


class CycleFilteredWarping(Regularizer[CycleFilteredWarpingSettings]):
    """mean |render - photograph at the rendered depth| over the pixels and photographs that count.

    Gradients flow through the virtual view's colours and depth; the photographs' own depths only filter.
    """

    def loss(self, step: Step) -> Tensor:
        """The term at a camera drawn for this iteration; 0 where no pixel counts."""
        import torch

        camera = self._camera(step)
        rendering = step.render(camera)
        shown = rendering.alpha.detach() >= SMALLEST_ALPHA
        depth = _depth(rendering)
        points = camera.unproject(*camera.pixel_centers(), depth)
        views = step.scene.train
        with torch.no_grad():
            counts = torch.stack(
                [self._returns(step, v.camera, camera, points, depth) for v in views]
            )
            counts &= shown
            counts &= counts.sum(dim=0) >= self.settings.agreeing * len(views)
        step.log(f"{self.context.name}_counted", float(counts.any(dim=0).float().mean()))
        differences = []
        for view, chosen in zip(views, counts, strict=True):
            u, v, _ = view.camera.project(points[chosen])
            colors, _ = look_up(view.image, u, v)
            differences.append((rendering.rgb[chosen] - colors).abs())
        together = torch.cat(differences)
        return together.mean() if len(together) else torch.zeros(())

    def _camera(self, step: Step) -> Camera:
        """A random training camera, moved onto the sphere round it."""
        import torch

        views = step.scene.train
        near = views[int(torch.randint(len(views), (), generator=self.generator))].camera
        direction = torch.randn(3, generator=self.generator, dtype=torch.float64)
        shift = torch.zeros(4, 4, dtype=torch.float64)
        shift[:3, 3] = self.settings.radius * step.extent * direction / direction.norm()
        return replace(near, world_to_camera=near.world_to_camera + shift)

    def _returns(
        self, step: Step, there: Camera, camera: Camera, points: Tensor, depth: Tensor
    ) -> Tensor:
        """Which pixels of `camera` come back from another to nearly their own depth, bool `[H, W]`."""
        u, v, z = there.project(points)
        known = _depth(step.render(there, gradient=False))
        met, inside = look_up(known[..., None], u, v)
        _, _, returned = camera.project(there.unproject(u, v, met[..., 0]))
        limit = self.settings.max_depth_error * depth.max()
        return inside & (z > 0) & ((returned - depth).abs() < limit)


def _depth(rendering: Rendering) -> Tensor:
    """Depth over alpha `[H, W]`, world units; too small where alpha nearly vanishes."""
    return rendering.depth / rendering.alpha.clamp(min=SMALLEST_ALPHA)
