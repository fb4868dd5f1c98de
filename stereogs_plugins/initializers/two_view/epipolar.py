"""Depth from correspondences between two cameras (Hartley and Zisserman 2004, chapter 9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingScene

BOUNDS_MARGIN = 1.1
"""Depths outside near / margin to far * margin come from wrong correspondences."""
STEP = 0.5
"""Step along the epipolar line for measuring the sensitivity, pixels."""


@dataclass(frozen=True, eq=False)
class Intersection:
    """Results for P correspondences.

    Args:
        depth: `[P]` float64 z-depth in the first camera, world units; NaN where the rays do not meet in
            front of both cameras.
        distance: `[P]` float64 distance of the second position from the epipolar line of the first, pixels.
        sensitivity: `[P]` float64 change of depth per pixel along that line; not finite where depth is
            unknown.
    """

    depth: Tensor
    distance: Tensor
    sensitivity: Tensor


def intersect(first: Camera, second: Camera, here: Tensor, there: Tensor) -> Intersection:
    """Intersect rays of the first camera with those of the second.

    A second position is first moved to the nearest point of its epipolar line, so that both rays lie in
    one plane.

    Args:
        here, there: `[P, 2]` columns and rows in the first and in the second image, pixels.
    """
    import torch

    relative = second.world_to_camera @ first.camera_to_world
    shift = relative[:3, 3]
    rays = _homogeneous(here) @ torch.linalg.inv(first.intrinsics).T @ relative[:3, :3].T
    back = torch.linalg.inv(second.intrinsics)
    # Epipolar lines: the plane of a ray and both centres, in the second image.
    lines = torch.linalg.cross(shift.expand_as(rays), rays) @ back
    normals = lines[:, :2] / lines[:, :2].norm(dim=1, keepdim=True)
    signed = (_homogeneous(there) * lines).sum(1) / lines[:, :2].norm(dim=1)
    feet = there.double() - signed[:, None] * normals
    along = torch.stack([-normals[:, 1], normals[:, 0]], dim=1)
    depths = [
        _meeting(rays, shift, _homogeneous(feet + offset * along) @ back.T)
        for offset in (0.0, STEP, -STEP)
    ]
    return Intersection(depths[0], signed.abs(), (depths[1] - depths[2]).abs() / (2 * STEP))


def within_bounds(depth: Tensor, scene: TrainingScene) -> Tensor:
    """Mask of depths that can be the scene's content."""
    near, far = scene.bounds
    inside: Tensor = (depth > near / BOUNDS_MARGIN) & (depth < far * BOUNDS_MARGIN)
    return inside


def _meeting(rays: Tensor, shift: Tensor, directions: Tensor) -> Tensor:
    """The z with z * ray + shift parallel to a direction, in the second camera; NaN if none."""
    import torch

    moved = torch.linalg.cross(shift.expand_as(directions), directions)
    turned = torch.linalg.cross(rays, directions)
    z = -(moved * turned).sum(1) / turned.square().sum(1)
    in_front = (z > 0) & (z * rays[:, 2] + shift[2] > 0)
    depth: Tensor = z.where(in_front, torch.nan)
    return depth


def _homogeneous(pixels: Tensor) -> Tensor:
    from torch.nn.functional import pad

    return pad(pixels.double(), (0, 1), value=1.0)
