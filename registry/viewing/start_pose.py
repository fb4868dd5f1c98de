"""Where a visitor stands first, and what turning turns around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from core_rasterizer import Camera

from ..contract.scene import Scene
from ..drawing.orientation import Vector, upwards
from .subject import Subject

_UP_WITHOUT_CAMERAS = (0.0, -1.0, 0.0)
"""Scenes of COLMAP and 3DGS have their y axis downwards more often than not."""
_BEHIND, _ABOVE = 0.5, 0.25
"""The first camera, in units of the scene's extent: its photograph must not stand in front of the scene."""
_DISTANCE = 2.5
"""From the middle of Gaussians without cameras, in units of their spread."""


@dataclass(frozen=True, eq=False)
class StartPose:
    """A place, what is looked at from it, and which way is up; `[3]` world units each.

    Args:
        field_of_view: vertical, radians.
    """

    position: Vector
    look_at: Vector
    up: Vector
    field_of_view: float

    @property
    def distance(self) -> float:
        """From the place to what is looked at, world units, > 0."""
        return max(float(np.linalg.norm(self.look_at - self.position)), 1e-6)


def start_pose(subject: Subject) -> StartPose:
    """Over the first training camera's shoulder, turning about what it sees; without cameras, all is seen."""
    means = subject.model.read("means").double()
    if subject.scene is None:
        middle = means.median(dim=0).values
        spread = float((means - middle).norm(dim=1).median())
        offset = torch.tensor([0.0, 0.0, -_DISTANCE * spread], dtype=torch.float64)
        vertical = np.asarray(_UP_WITHOUT_CAMERAS)
        return StartPose((middle + offset).numpy(), middle.numpy(), vertical, np.pi / 3)
    cameras = [view.camera for view in subject.scene.train]
    first, depth = cameras[0], _depth_in_front(cameras[0], means, subject.scene)
    center, forward = first.center.numpy(), first.world_to_camera[2, :3].numpy()
    up, extent = upwards(cameras), subject.scene.extent
    position = center + extent * (_ABOVE * up - _BEHIND * forward)
    height = 2 * np.arctan(0.5 * first.height / first.fy)
    return StartPose(position, center + depth * forward, up, float(height))


def _depth_in_front(camera: Camera, means: torch.Tensor, scene: Scene) -> float:
    """The median z-depth of what a camera sees, world units."""
    u, v, z = camera.project(means)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    seen = z[inside]
    return float(seen.median()) if len(seen) else float(np.sqrt(np.prod(scene.bounds)))
