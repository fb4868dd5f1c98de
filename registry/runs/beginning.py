"""Where a run stands before its first iteration, for what chooses how it goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from core_rasterizer import Device, Gaussians

from ..contract.scene import PointCloud, Scene
from ..pipeline.pipeline import Pipeline
from ..training.initial_model import initial_gaussians


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where a run stands before its first iteration.

    Args:
        pipeline: that made the points.
        scene: what is trained on.
        points: what the initializer gave.
        gaussians: the first ones, made of them.
        device: what trains.
    """

    pipeline: Pipeline
    scene: Scene
    points: PointCloud
    gaussians: Gaussians
    device: Device

    def of(self, pipeline: Pipeline) -> Beginning:
        """The same points as the first Gaussians of another pipeline."""
        gaussians = initial_gaussians(self.points, pipeline.training)
        return replace(self, pipeline=pipeline, gaussians=gaussians)


Fit = Callable[[Beginning], Pipeline]
"""Says which pipeline trains what another one has begun: one with the same scene, priors and initializer, so
that alone it begins in the same way and ends in the same bits."""
