"""Cameras, depths and priors with known answers for the tests of dense initialization."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from core_rasterizer import Camera, open_device
from registry import Context, PointCloud, Scene, Settings, TrainingScene, TrainingView, View
from registry.priors import DepthMap, MultiViewDepthPrior
from stereogs_plugins.initializers.consistency_dense.projection import DepthImage
from stereogs_plugins.initializers.consistency_dense.view_depth import ViewDepth


def camera_at(
    x: float,
    y: float = 0.0,
    *,
    width: int = 60,
    height: int = 40,
    cx: float = 30.0,
    cy: float = 20.0,
) -> Camera:
    """A camera at (x, y, 0) that looks along +z with a focal length of 50 pixels."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3], pose[1, 3] = -x, -y
    return Camera(pose, 50.0, 50.0, cx, cy, width, height)


def camera_towards_origin(angle: float) -> Camera:
    """A camera that looks at the origin from 4 units away, turned about the y axis by degrees."""
    turn = torch.tensor(angle, dtype=torch.float64).deg2rad()
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 0] = pose[2, 2] = turn.cos()
    pose[0, 2], pose[2, 0] = turn.sin(), -turn.sin()
    pose[2, 3] = 4.0
    return Camera(pose, 50.0, 50.0, 30.0, 20.0, 60, 40)


def plane_depth(camera: Camera, z: float) -> Tensor:
    """`[H, W]` float32 depth of the plane of all points with that z."""
    u, v = camera.pixel_centers()
    at_one = camera.unproject(u, v, torch.ones_like(u))[..., 2]
    center = camera.center[2]
    return ((z - center) / (at_one - center)).float()


def view_of(camera: Camera, image: Tensor | None = None, name: str = "view") -> View:
    """A view, grey unless an image is given."""
    if image is None:
        image = torch.full((camera.height, camera.width, 3), 0.5)
    return View(name, camera, image)


def known(view: View, depth: DepthImage) -> ViewDepth:
    """A view whose depths are all confirmed."""
    return ViewDepth(view, depth, depth, np.zeros_like(depth))


class FixedDepth(MultiViewDepthPrior[Settings]):
    """Returns the depth that a function gives for each view."""

    depth_of: Callable[[Any], Tensor]

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        depths = [self.depth_of(view) for view in views]
        return [DepthMap(d, torch.isfinite(d) & (d > 0), torch.ones_like(d)) for d in depths]


def prior_of(depth_of: Callable[[Any], Tensor]) -> FixedDepth:
    """A prior that returns `depth_of(view)`."""
    prior = FixedDepth(Settings(), Context("fixed", 0, open_device()))
    prior.depth_of = depth_of
    return prior


def as_it_is(scene: Scene) -> TrainingScene:
    """The scene with its true depth, which the priors of these tests answer."""
    return cast(TrainingScene, scene)


def true_depth(view: View) -> Tensor:
    """True depth of a procedural view."""
    assert view.depth is not None
    return view.depth


def pixels_of(points: PointCloud, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Column, row and depth of each point, clamped to the image."""
    u, v, depth = camera.project(points.positions)
    x, y = u.long().clamp(0, camera.width - 1), v.long().clamp(0, camera.height - 1)
    return x, y, depth


def distance_to_surface(scene: Scene, points: PointCloud) -> Tensor:
    """`[P]` smallest relative depth error over the views."""
    best = torch.full((len(points),), torch.inf, dtype=torch.float64)
    for view in scene.train:
        x, y, depth = pixels_of(points, view.camera)
        best = torch.minimum(best, (depth / true_depth(view)[y, x] - 1).abs())
    return best
