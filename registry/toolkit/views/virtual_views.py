"""Virtual cameras between and around the training cameras, for losses on unseen views.

    camera = virtual_views.draw("between", scene, self.generator)
    rendering = step.render(camera)

Functions take at least one camera, and bounds as (near, far) z-depth in world units. All randomness comes
from the caller's generator. For a stereo partner, see `Camera.shifted_right`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from ...errors import PluginError

if TYPE_CHECKING:
    from torch import Generator, Tensor

    from core_rasterizer import Camera

    from ...contract.scene import TrainingScene

__all__ = ["VirtualViewKind", "draw"]

VirtualViewKind = Literal["box", "between", "sphere"]
"""Function that `draw` uses: `in_box`, `between_neighbours` or `on_sphere`."""

_MIN_EIGENVALUE = 1e-6
"""Of `nearest_to_axes`; axes within about a milliradian count as parallel."""


def draw(kind: VirtualViewKind, scene: TrainingScene, generator: Generator) -> Camera:
    """Return a random camera near the training cameras of a scene, with the lens of one of them."""
    cameras = [view.camera for view in scene.train]
    if kind == "between":
        return between_neighbours(cameras, generator)
    place = in_box if kind == "box" else on_sphere
    return place(cameras, scene.bounds, generator)


def focus_depth(bounds: tuple[float, float]) -> float:
    """Return the z-depth that cameras of a forward-facing capture focus on, world units.

    A weighted harmonic mean of 0.9 near and 5 far: 1 / (0.25 / (0.9 near) + 0.75 / (5 far)) (LLFF,
    Mildenhall et al. 2019, and after it RegNeRF and FSGS), for positive (near, far) z-depths.
    """
    near, far = bounds
    return 1 / (0.25 / (0.9 * near) + 0.75 / (5 * far))


def focus_point(cameras: Sequence[Camera], bounds: tuple[float, float]) -> Tensor:
    """Return the point nearest to all optical axes, least squares, `[3]` float64 (RegNeRF).

    For parallel or diverging axes, the point at `focus_depth` in front of the cameras' mean.
    """
    import torch

    from ..photos.focus import nearest_to_axes

    point = nearest_to_axes(cameras, _MIN_EIGENVALUE)
    if point is not None:
        return torch.from_numpy(point)
    axes = torch.stack([c.camera_to_world[:3, 2] for c in cameras]).sum(0)
    ahead = axes / axes.norm().clamp(min=1e-12)
    before: Tensor = _centers(cameras).mean(0) + focus_depth(bounds) * ahead
    return before


def looking_at(camera: Camera, place: Tensor, target: Tensor) -> Camera:
    """Return the camera moved to `place` and rotated so that `target` is on its axis, with the same up.

    Args:
        place, target: `[3]`, world units; different points, not vertically above each other in the
            camera's frame.

    Raises:
        CameraError: The points violate this.
    """
    from core_rasterizer import Camera

    up = -camera.camera_to_world[:3, 1]
    turned = Camera.look_at(
        place.tolist(), target.tolist(), camera.fx, camera.width, camera.height, up=up.tolist()
    )
    return replace(camera, world_to_camera=turned.world_to_camera)


def between(first: Camera, second: Camera, share: float) -> Camera:
    """Interpolate between two cameras: a share of 0 returns the first pose, 1 the second.

    Centers follow a straight line, rotations the shortest arc; the lens is the first one's.
    """
    import torch
    from scipy.spatial.transform import Rotation, Slerp

    turns = Rotation.from_matrix([c.camera_to_world[:3, :3].tolist() for c in (first, second)])
    rotation = torch.from_numpy(Slerp([0, 1], turns)([share]).as_matrix()[0])
    return _placed(first, rotation, (1 - share) * first.center + share * second.center)


def between_neighbours(cameras: Sequence[Camera], generator: Generator) -> Camera:
    """Return a camera between a random one and its nearest neighbor (FSGS, Zhu et al. 2024).

    The interpolation share is uniform; normal noise with a standard deviation of a tenth of their distance
    is added to each coordinate of the center. The paper does not specify these numbers. A single camera is
    returned unmoved.
    """
    import torch

    centers = _centers(cameras)
    chosen = int(torch.randint(len(cameras), (), generator=generator))
    distances = (centers - centers[chosen]).norm(dim=1)
    distances[chosen] = math.inf
    nearest = int(distances.argmin()) if len(cameras) > 1 else chosen
    share = float(torch.rand((), generator=generator, dtype=torch.float64))
    camera = between(cameras[chosen], cameras[nearest], share)
    spread = 0.1 * float((centers[nearest] - centers[chosen]).norm())
    noise = spread * torch.randn(3, generator=generator, dtype=torch.float64)
    return _placed(camera, camera.camera_to_world[:3, :3], camera.center + noise)


def in_box(cameras: Sequence[Camera], bounds: tuple[float, float], generator: Generator) -> Camera:
    """Return a camera in the box around the training cameras, oriented to a common focus.

    The method of RegNeRF (Niemeyer et al. 2022) for forward-facing captures, also used by FSGS and
    CoR-GS: in the frame of the mean camera, each coordinate is uniform within the largest absolute value
    of any camera; the target is the point at `focus_depth` on the mean camera's axis. The lens is the first
    camera's.

    Raises:
        PluginError: The cameras have no mean direction.
    """
    import torch

    mean = _mean_camera(cameras)
    frame, center = mean.camera_to_world[:3, :3], mean.center
    reach = ((_centers(cameras) - center) @ frame).abs().amax(0)
    drawn = 2 * torch.rand(3, generator=generator, dtype=torch.float64) - 1
    place = center + frame @ (reach * drawn)
    return looking_at(mean, place, center + focus_depth(bounds) * frame[:, 2])


def on_sphere(
    cameras: Sequence[Camera], bounds: tuple[float, float], generator: Generator
) -> Camera:
    """Return a camera on a sphere around the `focus_point`, oriented towards it.

    For captures around an object (RegNeRF's poses for its synthetic scenes). Directions are uniform
    on the smallest cap around their mean that contains all training cameras, distances uniform between
    the nearest and the farthest. Lens and up are those of the camera nearest in direction.
    """
    import torch

    focus = focus_point(cameras, bounds)
    away = _centers(cameras) - focus
    distances = away.norm(dim=1)
    directions = away / distances[:, None]
    mean = directions.sum(0)
    pole = mean / mean.norm() if float(mean.norm()) > 1e-6 else directions[0]
    drawn = torch.rand(3, generator=generator, dtype=torch.float64)
    lowest = float((directions @ pole).min())
    height = lowest + (1 - lowest) * float(drawn[0])
    direction = _on_circle(pole, height, 2 * math.pi * float(drawn[1]))
    distance = distances.min() + (distances.max() - distances.min()) * drawn[2]
    model = cameras[int((directions @ direction).argmax())]
    return looking_at(model, focus + distance * direction, focus)


def _on_circle(pole: Tensor, height: float, angle: float) -> Tensor:
    """Return the unit vector with component `height` along `pole`, at this angle around it."""
    import torch

    helper = torch.zeros(3, dtype=torch.float64)
    helper[int(pole.abs().argmin())] = 1
    right = torch.linalg.cross(pole, helper)
    right = right / right.norm()
    around = math.cos(angle) * right + math.sin(angle) * torch.linalg.cross(pole, right)
    vector: Tensor = height * pole + math.sqrt(max(0.0, 1 - height**2)) * around
    return vector


def _mean_camera(cameras: Sequence[Camera]) -> Camera:
    """Return a camera with the mean center, axis and up, and the first one's lens."""
    import torch

    center = _centers(cameras).mean(0)
    forward = torch.stack([c.camera_to_world[:3, 2] for c in cameras]).mean(0)
    down = torch.stack([c.camera_to_world[:3, 1] for c in cameras]).mean(0)
    right = torch.linalg.cross(down, forward)
    if not float(right.norm()) > 1e-6:
        raise PluginError(
            "the training cameras face each other and have no mean direction",
            fix="use virtual views of kind `sphere`",
        )
    forward, right = forward / forward.norm(), right / right.norm()
    axes = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=1)
    return _placed(cameras[0], axes, center)


def _centers(cameras: Sequence[Camera]) -> Tensor:
    import torch

    return torch.stack([camera.center for camera in cameras])


def _placed(camera: Camera, camera_axes: Tensor, center: Tensor) -> Camera:
    """Return the camera moved to `center` `[3]`, with the columns of `[3, 3]` as axes."""
    import torch

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = camera_axes.T
    pose[:3, 3] = -camera_axes.T @ center
    return replace(camera, world_to_camera=pose)
