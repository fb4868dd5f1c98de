"""Angles between a view and the training views, which bound how much of a view they determine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera


class ViewAngles(NamedTuple):
    """Angles at a point, in degrees.

    Args:
        nearest: between a camera and the nearest training camera.
        outside: between a camera and the cone that the training cameras span; 0 inside.
    """

    nearest: float
    outside: float


def view_angles(camera: Camera, training: Sequence[Camera], subject: Tensor) -> ViewAngles:
    """Return how far a camera is from the training cameras, as seen from a point of the scene.

    The cone consists of all directions that are sums of the directions to training cameras with weights >= 0:
    a camera inside looks from between them (interpolation), one outside extrapolates.

    Args:
        training: at least one.
        subject: `[3]`, world units; no camera is there.
    """
    from scipy import optimize

    def direction(of: Camera) -> Tensor:
        return torch.nn.functional.normalize((of.center - subject).double(), dim=0)

    own, others = direction(camera), torch.stack([direction(other) for other in training])
    nearest = float((others @ own).clamp(-1, 1).max().arccos())
    _, distance = optimize.nnls(others.T.numpy(), own.numpy())  # type: ignore[attr-defined]
    outside = math.asin(min(1.0, float(distance)))
    return ViewAngles(math.degrees(nearest), math.degrees(min(outside, nearest)))


def subject_of(camera: Camera, bounds: tuple[float, float], points: Tensor | None = None) -> Tensor:
    """Return the point on the optical axis at the median z-depth of the points in view, `[3]`.

    Args:
        bounds: (near, far) z-depth; their geometric mean is used if no point is in view.
        points: `[P, 3]`, world units.
    """
    depth = math.sqrt(bounds[0] * bounds[1])
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    if points is not None:
        local = points.to(rotation.dtype) @ rotation.T + translation
        pixels = local @ camera.intrinsics.to(rotation.dtype).T
        u, v = (pixels[:, :2] / local[:, 2:]).unbind(dim=1)
        inside = (local[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        if inside.any():
            depth = float(local[inside, 2].median())
    return camera.center + depth * rotation[2]
