"""Cameras where no photograph was taken, for losses on what must look right from there too.

A stereo partner of a camera is `Camera.shifted_right`. Everything random comes from the caller's
generator.
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

__all__ = [
    "VirtualViewKind",
    "between",
    "between_neighbours",
    "draw",
    "focus_depth",
    "focus_point",
    "in_box",
    "looking_at",
    "on_sphere",
]

VirtualViewKind = Literal["box", "between", "sphere"]
"""How `draw` places a camera: `in_box`, `between_neighbours` or `on_sphere`."""

_PARALLEL = 1e-6
"""Axes that differ by less than about a milliradian meet nowhere worth looking at."""


def draw(kind: VirtualViewKind, scene: TrainingScene, generator: Generator) -> Camera:
    """One random camera among the training cameras of a scene, with a training camera's lens."""
    cameras = [view.camera for view in scene.train]
    if kind == "between":
        return between_neighbours(cameras, generator)
    place = in_box if kind == "box" else on_sphere
    return place(cameras, scene.bounds, generator)


def focus_depth(bounds: tuple[float, float]) -> float:
    """The z-depth that cameras of a forward-facing capture turn towards, world units.

    A weighted harmonic mean of 0.9 near and 5 far: 1 / (0.25 / (0.9 near) + 0.75 / (5 far)) (LLFF,
    Mildenhall et al. 2019, and after it RegNeRF and FSGS).

    Args:
        bounds: (near, far) z-depth, world units, > 0.
    """
    near, far = bounds
    return 1 / (0.25 / (0.9 * near) + 0.75 / (5 * far))


def focus_point(cameras: Sequence[Camera], bounds: tuple[float, float]) -> Tensor:
    """The point nearest to all optical axes, least squares, `[3]` float64 (RegNeRF).

    Where the axes are parallel or part, it lies at `focus_depth` in front of the cameras' mean.

    Args:
        cameras: at least one.
    """
    import torch

    centers, axes = _centers(cameras), torch.stack([c.camera_to_world[:3, 2] for c in cameras])
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    total, middle = across.sum(0), centers.mean(0)
    ahead = axes.sum(0) / axes.sum(0).norm().clamp(min=1e-12)
    if float(torch.linalg.eigvalsh(total)[0]) > _PARALLEL * len(cameras):
        point: Tensor = torch.linalg.solve(total, (across @ centers[:, :, None]).sum(0)[:, 0])
        if float(((point - centers) * axes).sum(1).min()) > 0:
            return point
    before: Tensor = middle + focus_depth(bounds) * ahead
    return before


def looking_at(camera: Camera, place: Tensor, target: Tensor) -> Camera:
    """The same lens at another place, turned so that `target` is on the optical axis, upright as before.

    Args:
        place, target: `[3]`, world units; not the same point, and not one above the other as the
            camera sees it.

    Raises:
        CameraError: no camera looks that way.
    """
    from core_rasterizer import Camera

    up = -camera.camera_to_world[:3, 1]
    turned = Camera.look_at(
        place.tolist(), target.tolist(), camera.fx, camera.width, camera.height, up=up.tolist()
    )
    return replace(camera, world_to_camera=turned.world_to_camera)


def between(first: Camera, second: Camera, share: float) -> Camera:
    """The first camera, moved and turned towards the second by a share: 0 is the first, 1 the second.

    Centres follow a straight line, rotations the shortest turn.
    """
    import torch
    from scipy.spatial.transform import Rotation, Slerp

    turns = Rotation.from_matrix([c.camera_to_world[:3, :3].tolist() for c in (first, second)])
    rotation = torch.from_numpy(Slerp([0, 1], turns)([share]).as_matrix()[0])
    return _placed(first, rotation, (1 - share) * first.center + share * second.center)


def between_neighbours(cameras: Sequence[Camera], generator: Generator) -> Camera:
    """A camera between a random one and the one nearest to it (FSGS, Zhu et al. 2024).

    How far between the two is uniform; its place is then moved by normal noise of a tenth of their
    distance in each direction. The paper names neither number.

    Args:
        cameras: at least one; one alone is moved by nothing.
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
    """A camera in the box around the training cameras, turned to what lies in the middle before them.

    The recipe for forward-facing captures of RegNeRF (Niemeyer et al. 2022), as FSGS and CoR-GS use it:
    in the frame of the mean camera, each coordinate is uniform between plus and minus the largest that
    a camera has; it looks at the point at `focus_depth` on the mean camera's axis.

    Args:
        cameras: at least one; the lens is the first one's.
        bounds: (near, far) z-depth of the scene, world units.

    Raises:
        PluginError: the cameras have no mean direction.
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
    """A camera as far from the `focus_point` as the training cameras are, turned towards it.

    For captures around an object (RegNeRF's poses for its synthetic scenes). Directions are uniform
    on the smallest cap about their mean that holds all training cameras, distances uniform between
    the nearest and the farthest.

    Args:
        cameras: at least one; the lens and the upright of the one nearest in direction are taken.
        bounds: (near, far) z-depth of the scene, world units.
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
    """The unit vector whose component along `pole` is `height`, at an angle about it."""
    import torch

    helper = torch.zeros(3, dtype=torch.float64)
    helper[int(pole.abs().argmin())] = 1
    right = torch.linalg.cross(pole, helper)
    right = right / right.norm()
    around = math.cos(angle) * right + math.sin(angle) * torch.linalg.cross(pole, right)
    vector: Tensor = height * pole + math.sqrt(max(0.0, 1 - height**2)) * around
    return vector


def _mean_camera(cameras: Sequence[Camera]) -> Camera:
    """At the mean of the centres, with the mean axis and upright, and the first one's lens."""
    import torch

    center = _centers(cameras).mean(0)
    forward = torch.stack([c.camera_to_world[:3, 2] for c in cameras]).mean(0)
    down = torch.stack([c.camera_to_world[:3, 1] for c in cameras]).mean(0)
    right = torch.linalg.cross(down, forward)
    if not float(right.norm()) > 1e-6:
        raise PluginError(
            "the training cameras face each other: there is no mean camera for a box around them",
            fix="place virtual views on a sphere",
        )
    forward, right = forward / forward.norm(), right / right.norm()
    axes = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=1)
    return _placed(cameras[0], axes, center)


def _centers(cameras: Sequence[Camera]) -> Tensor:
    import torch

    return torch.stack([camera.center for camera in cameras])


def _placed(camera: Camera, camera_axes: Tensor, center: Tensor) -> Camera:
    """The same lens at `center` `[3]`, with the axes that are the columns of `[3, 3]`."""
    import torch

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = camera_axes.T
    pose[:3, 3] = -camera_axes.T @ center
    return replace(camera, world_to_camera=pose)
