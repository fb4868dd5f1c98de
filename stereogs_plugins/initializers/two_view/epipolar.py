"""Depth of a pixel from where another camera shows the same (Hartley and Zisserman 2004, chapter 9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingScene

BOUNDS_MARGIN = 1.1
"""A point nearer than near / margin or farther than far * margin comes from a wrong correspondence."""
STEP = 0.5
"""Pixels along the epipolar line by which the sensitivity is measured."""


@dataclass(frozen=True, eq=False)
class Intersection:
    """What P correspondences say.

    Args:
        depth: `[P]` float64 z-depth in the first camera, world units; NaN where the rays meet behind a
            camera or nowhere.
        distance: `[P]` float64 pixels from the second position to the epipolar line of the first.
        sensitivity: `[P]` float64, by how much depth changes per pixel along that line; not finite
            where depth is unknown.
    """

    depth: Tensor
    distance: Tensor
    sensitivity: Tensor


def intersect(first: Camera, second: Camera, here: Tensor, there: Tensor) -> Intersection:
    """Where the first camera's rays meet those of the second.

    A second position is first moved to the nearest point of its epipolar line; the two rays then lie in
    one plane.

    Args:
        here, there: `[P, 2]` columns and rows in the first and in the second image, pixels.
    """
    import torch

    relative = second.world_to_camera @ first.camera_to_world
    shift = relative[:3, 3]
    rays = _homogeneous(here) @ torch.linalg.inv(first.intrinsics).T @ relative[:3, :3].T
    back = torch.linalg.inv(second.intrinsics)
    # The plane of the ray and both centres, seen as a line in the second image.
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
    """Which depths can be the scene's content, bool."""
    near, far = scene.bounds
    inside: Tensor = (depth > near / BOUNDS_MARGIN) & (depth < far * BOUNDS_MARGIN)
    return inside


def _meeting(rays: Tensor, shift: Tensor, directions: Tensor) -> Tensor:
    """The z with z * ray + shift along a direction, all in the second camera; NaN where there is none."""
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
