"""A small real stereo matcher, and a textured wall to match on."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry import Scene, Settings, Step, View
from registry.priors import StereoPrior
from registry.testing import step_of

WIDTH, HEIGHT, FOCAL = 96, 48, 80.0
DEPTH = 4.0
BASELINE = 0.5
"""World units; the wall then has a disparity of 10 pixels."""


class BlockMatcherSettings(Settings):
    reach: int = 20
    """Largest disparity tried, in pixels."""
    radius: int = 3
    """Of the blocks that are compared, in pixels."""


class BlockMatcher(StereoPrior[BlockMatcherSettings]):
    """Per pixel the shift with the smallest mean difference of a block, refined by a parabola.

    Attributes:
        asked: how many pairs it was asked about.
    """

    asked = 0

    @property
    def max_disparity(self) -> float:
        """See the settings."""
        return float(self.settings.reach)

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """The disparity; NaN where the block would leave the right image."""
        self.asked += 1
        height, width, _ = left.shape
        costs = torch.full((self.settings.reach + 2, height, width), torch.inf)
        for shift in range(min(self.settings.reach + 2, width)):
            difference = (left[:, shift:] - right[:, : width - shift]).abs().mean(dim=2)
            size = 2 * self.settings.radius + 1
            costs[shift, :, shift:] = avg_pool2d(
                difference[None], size, 1, self.settings.radius, count_include_pad=False
            )[0]
        best = costs[1:-1].argmin(dim=0) + 1
        before, here, after = (costs.gather(0, best[None] + k)[0] for k in (-1, 0, 1))
        curvature = (before - 2 * here + after).clamp(min=1e-9)
        answer = best + ((before - after) / (2 * curvature)).clamp(-0.5, 0.5)
        return torch.where(torch.isfinite(after) & (here < 0.05), answer, torch.nan)


class PrintedOrder(BlockMatcher):
    """The right image's disparity with the images in the order that the paper prints."""

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Both; the second is of no use."""
        mirrored = self.estimate(left.flip(1).contiguous(), right.flip(1).contiguous())
        return self.estimate(left, right), mirrored.flip(1)


def wall(depth: float = DEPTH) -> Gaussians:
    """Opaque Gaussians of random greys that fill the view of `CAMERA` and beyond, at one depth."""
    columns, rows = 70, 32
    x = torch.linspace(-3.4, 4.2, columns).repeat(rows) * depth / DEPTH
    y = torch.linspace(-1.7, 1.7, rows).repeat_interleave(columns) * depth / DEPTH
    positions = torch.stack([x, y, torch.full_like(x, depth)], dim=1)
    colors = torch.rand(len(x), 1, generator=torch.Generator().manual_seed(3)).expand(-1, 3)
    scales = torch.full((len(x),), 0.07 * depth / DEPTH)
    return Gaussians.from_points(positions, colors, scales, torch.full((len(x),), 0.95), 0)


CAMERA = Camera(torch.eye(4), FOCAL, 1.1 * FOCAL, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)


class Wall:
    """A model of the wall, its photograph, and steps that look at it.

    Attributes:
        logged: the newest number of every name that a step logged.
    """

    def __init__(self, gaussians: Gaussians | None = None, alpha: Tensor | None = None) -> None:
        truth = GaussianModel(wall(), open_device())
        with torch.no_grad():
            photograph = truth.render(CAMERA).rgb.clamp(0, 1)
        self.view = View("wall", CAMERA, photograph, alpha=alpha)
        self.scene = Scene("wall", (self.view,), (), (2.0, 10.0))
        self.model = GaussianModel(gaussians or wall(), open_device())
        self.logged: dict[str, float] = {}

    def step(self, **priors: StereoPrior[Any]) -> Step:
        """An iteration after its render."""
        self.model.zero_gradients()
        return step_of(
            self.model,
            self.scene,
            rendering=self.model.render(CAMERA),
            iteration=1,
            iterations=10,
            priors=priors,
            log=self.logged.__setitem__,
        )
