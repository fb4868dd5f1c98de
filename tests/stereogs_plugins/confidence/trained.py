"""A small training result for tests of estimators."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.confidence import Confidence, Trained
from registry.testing import tiny_scene


def small(count: int = 60, kinds: Mapping[str, Tensor] | None = None) -> Trained:
    """The points of the small scene as Gaussians, not trained."""
    scene = tiny_scene()
    assert scene.points is not None
    positions, colors = scene.points.positions[:count], scene.points.colors[:count]
    sizes, opacities = torch.full((count,), 0.2), torch.full((count,), 0.6)
    gaussians = Gaussians.from_points(positions, colors, sizes, opacities, 0)
    model = GaussianModel(gaussians, open_device())
    return Trained(model.reader(), scene.for_training(), {}, kinds or {}, _none)


def _none(name: str) -> Confidence:
    raise KeyError(name)
