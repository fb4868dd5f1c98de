"""Where a visitor stands first, and what turning turns around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from core_rasterizer import Camera
from registry.contract import camera_extent
from registry.toolkit.drawing import Vector, upwards

from .subject import Subject

_UP_WITHOUT_CAMERAS = (0.0, -1.0, 0.0)
"""Scenes of COLMAP and 3DGS have their y axis downwards more often than not."""
_BEHIND, _ABOVE = 0.5, 0.25
"""The first camera, in units of the cameras' extent: its photograph must not stand in front of the scene."""
_DISTANCE = 2.5
"""From the middle of Gaussians without cameras, in units of their spread."""
_EXTENT_OF_ONE = 0.1
"""Of cameras at one place, in units of the depth of what the first one sees."""
_NOTHING_SEEN = 5.0
"""How far turning turns around a point where the first camera sees nothing, in units of the extent."""


@dataclass(frozen=True, eq=False)
class StartPose:
    """A place, what is looked at from it, and which way is up; `[3]` world units each.

    Args:
        field_of_view: vertical, radians.
        extent: of the cameras, world units, > 0.
    """

    position: Vector
    look_at: Vector
    up: Vector
    field_of_view: float
    extent: float

    @property
    def distance(self) -> float:
        """From the place to what is looked at, world units, > 0."""
        return max(float(np.linalg.norm(self.look_at - self.position)), 1e-6)


def start_pose(subject: Subject) -> StartPose:
    """Over the first training camera's shoulder, turning about what it sees; without cameras, all is seen."""
    means = subject.model.read("means").double()
    cameras = [one.camera for one in subject.standpoints if not one.is_test]
    if not cameras:
        middle = means.median(dim=0).values
        spread = float((means - middle).norm(dim=1).median())
        offset = torch.tensor([0.0, 0.0, -_DISTANCE * spread], dtype=torch.float64)
        vertical = np.asarray(_UP_WITHOUT_CAMERAS)
        return StartPose((middle + offset).numpy(), middle.numpy(), vertical, np.pi / 3, spread)
    first = cameras[0]
    depth, extent = _depth_and_extent(cameras, means)
    center, forward = first.center.numpy(), first.world_to_camera[2, :3].numpy()
    up = upwards(cameras)
    position = center + extent * (_ABOVE * up - _BEHIND * forward)
    height = 2 * np.arctan(0.5 * first.height / first.fy)
    return StartPose(position, center + depth * forward, up, float(height), extent)


def _depth_and_extent(cameras: Sequence[Camera], means: torch.Tensor) -> tuple[float, float]:
    """The median z-depth of what the first camera sees, and the cameras' extent, world units, > 0."""
    first, extent = cameras[0], camera_extent(cameras)
    u, v, z = first.project(means)
    seen = z[first.contains(u, v, z)]
    depth = float(seen.median()) if len(seen) else _NOTHING_SEEN * max(extent, 1e-6)
    return depth, extent if extent > 1e-6 * depth else _EXTENT_OF_ONE * depth
