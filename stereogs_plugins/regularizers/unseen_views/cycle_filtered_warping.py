"""`cycle_filtered_warping`: compare virtual views with photographs where the depth is cycle consistent.

The appearance loss of ICO-GS (2026, arXiv 2603.02893). A virtual view near a training camera is rendered,
and its pixels are projected into all photographs by their depth. A photograph is used where projecting back
by its own rendered depth returns nearly the original depth, and a pixel only if at least half of the
photographs agree.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Percent, Regularizer, Settings, Step

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

MIN_ALPHA = 0.05
"""Pixels with a lower alpha have no valid depth."""


class CycleFilteredWarpingSettings(Settings):
    radius: float = Field(0.1, gt=0)
    """Distance of virtual cameras from a training camera, whose direction they share, in units of the
    scene's extent. The paper's value is unknown."""
    max_depth_error: float = Field(0.01, gt=0)
    """Largest cycle error of a pixel's depth, relative to the largest depth in the render."""
    agreeing: float = Field(0.5, gt=0, le=1)
    """Minimum share of the training views within `max_depth_error`."""


class CycleFilteredWarping(Regularizer[CycleFilteredWarpingSettings]):
    """mean |render - photograph at the rendered depth| over the consistent pixels and photographs.

    Gradients flow through the virtual view's colours and depth; the training views' depths only filter.
    """

    host_defaults = HostDefaults(start=Percent(83.34))

    def loss(self, step: Step) -> Tensor:
        """Return the loss at a random camera; 0 if no pixel is consistent."""
        import torch

        camera = self._camera(step)
        rendering = step.render(camera)
        shown = rendering.alpha.detach() >= MIN_ALPHA
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
            if view.weights is not None:
                at = view.camera.project(points)
                chosen = chosen & (look_up(view.weights[..., None], *at[:2])[0][..., 0] == 1)
            u, v, _ = view.camera.project(points[chosen])
            colors, _ = look_up(view.image, u, v)
            differences.append((rendering.rgb[chosen] - colors).abs())
        together = torch.cat(differences)
        return together.mean() if len(together) else torch.zeros(())

    def _camera(self, step: Step) -> Camera:
        """Return a random training camera, moved by `radius` in a random direction."""
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
        """Return the pixels of `camera` that are cycle consistent with `there`, bool `[H, W]`."""
        u, v, z = there.project(points)
        known = _depth(step.render(there, gradient=False))
        met, inside = look_up(known[..., None], u, v)
        _, _, returned = camera.project(there.unproject(u, v, met[..., 0]))
        limit = self.settings.max_depth_error * depth.max()
        return inside & (z > 0) & ((returned - depth).abs() < limit)


def _depth(rendering: Rendering) -> Tensor:
    """Return depth over alpha `[H, W]`, world units; too small where alpha is nearly 0."""
    return rendering.depth / rendering.alpha.clamp(min=MIN_ALPHA)


def look_up(image: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Sample an image bilinearly at pixel positions, in autograd of all arguments.

    Args:
        image: `[H, W, C]`.
        u, v: columns and rows `[...]`; the centre of the top-left pixel is (0.5, 0.5).

    Returns:
        `[..., C]`; and bool `[...]`, False outside the image, where the values are those of its border.
    """
    import torch
    from torch.nn.functional import grid_sample

    height, width = image.shape[:2]
    with torch.no_grad():
        inside = (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    grid = torch.stack([2 * u / width - 1, 2 * v / height - 1], dim=-1).reshape(1, 1, -1, 2)
    values = grid_sample(
        image.permute(2, 0, 1)[None], grid.to(image), padding_mode="border", align_corners=False
    )
    return values[0, :, 0].T.reshape(*u.shape, image.shape[2]), inside
