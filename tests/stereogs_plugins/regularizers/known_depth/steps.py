"""Steps whose render is a depth map of one's own choosing, in autograd."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, Rendering, open_device
from registry import Context, Scene, Settings, Step, View
from registry.priors import DepthMap, MonocularDepth, MonocularDepthPrior
from registry.testing import step_of
from tests.stereogs_plugins.building import some_gaussians


class FixedInverseDepth(MonocularDepthPrior[Settings]):
    """Answers with one map, and counts how often it is asked."""

    answer: Tensor | MonocularDepth
    asked = 0

    def estimate(self, image: Tensor) -> Tensor | MonocularDepth:
        self.asked += 1
        return self.answer


def fixed(inverse_depth: Tensor | MonocularDepth) -> FixedInverseDepth:
    prior = FixedInverseDepth(Settings(), Context("fixed", 0, open_device()))
    prior.answer = inverse_depth
    return prior


def step_with_depth(
    depth: Tensor,
    *,
    maps: dict[str, DepthMap] | None = None,
    inverse_depth: Tensor | MonocularDepth | None = None,
    bounds: tuple[float, float] = (1.0, 4.0),
) -> Step:
    """A step that renders `depth` `[H, W]`; the monocular prior, if asked, knows `inverse_depth`."""
    height, width = depth.shape
    camera = Camera(torch.eye(4), width, width, width / 2, height / 2, width, height)
    scene = Scene("map", (View("view", camera, torch.rand(height, width, 3)),), (), bounds)
    rendering = Rendering(torch.zeros(height, width, 3), depth, torch.ones(height, width))
    model = GaussianModel(some_gaussians([0.1], [0.5]), open_device())
    priors = {} if inverse_depth is None else {"mono": fixed(inverse_depth)}
    return step_of(model, scene, rendering=rendering, maps=maps, priors=priors)
