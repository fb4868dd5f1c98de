"""The up direction of a scene, cameras turned upright, and a smooth path through them for videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from core_rasterizer import Camera

from ...errors import RunError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Vector = NDArray[np.float64]

SAME_UP = np.cos(np.radians(45))
"""Cosine of the largest angle between the up directions of cameras that agree."""
CAMERA_LIMITS = {"angle": 10.0, "nearest": 0.5, "farthest": 1.25, "shift": 0.25}
"""How far a camera may be from the photographs: angle in degrees as seen from the subject, distance to
the subject as a factor of the photograph's, and shift of the middle as a share of that distance."""
_ROUNDS = 100
_LEAST_TILT = 0.2
"""Part of the up direction in the image plane from which the image shows where up is."""


def smooth_path(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Return cameras on a closed path through all given cameras, each turned upright (`quarter_turns`).

    Centers follow a cubic spline, rotations a spline of angular velocity (Park & Ravani 1997, as in
    scipy), focal lengths and principal points linear interpolation; the size is the
    most frequent one, and views of other proportions are cropped to it.

    Raises:
        RunError: There are fewer than two cameras or frames.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    if len(cameras) < 2 or frames < 2:
        raise RunError(
            f"no path exists through {len(cameras)} camera(s) in {frames} frame(s)",
            fix="use a scene with two or more training views, and two or more frames",
        )
    up = upwards(cameras)
    upright = [turned(camera, quarter_turns(camera, up)) for camera in cameras]
    sizes = [(camera.width, camera.height) for camera in upright]
    size = max(sizes, key=sizes.count)
    upright = [_cropped(camera, *size) for camera in upright]
    stops = [*upright, upright[0]]
    poses = np.stack([camera.camera_to_world.numpy() for camera in stops])
    times = np.arange(len(stops))
    at = np.linspace(0, len(stops) - 1, frames, endpoint=False)
    centers = CubicSpline(times, poses[:, :3, 3], bc_type="periodic")(at)
    rotations = RotationSpline(times, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    first = stops[0]
    lenses = np.array([[c.fx, c.fy, c.cx, c.cy] for c in stops])
    lens_at = np.stack([np.interp(at, times, column) for column in lenses.T], axis=1)
    path = []
    for center, rotation, (fx, fy, cx, cy) in zip(centers, rotations, lens_at, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ center
        world_to_camera = torch.from_numpy(pose)
        path.append(replace(first, world_to_camera=world_to_camera, fx=fx, fy=fy, cx=cx, cy=cy))
    return path


def _cropped(camera: Camera, width: int, height: int) -> Camera:
    """The view of another size without distortion; of other proportions its middle."""
    scale = max(width / camera.width, height / camera.height)
    return replace(
        camera,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=camera.cx * scale + (width - camera.width * scale) / 2,
        cy=camera.cy * scale + (height - camera.height * scale) / 2,
        width=width,
        height=height,
    )


def upwards(cameras: Sequence[Camera]) -> Vector:
    """Return the up direction of one or more images, `[3]`, unit length, world axes.

    It is the mean of the majority: of the directions within 45 degrees of the geometric median of all. A
    photograph on its side or upside down does not change it. If the directions cancel out, the up direction
    of the first camera.
    """
    directions = np.stack([-camera.world_to_camera[1, :3].numpy() for camera in cameras])
    median: Vector = directions.mean(axis=0)
    for _ in range(_ROUNDS):  # Weiszfeld 1937
        weights = 1 / np.maximum(np.linalg.norm(directions - median, axis=1), 1e-6)
        median = weights @ directions / weights.sum()
    agreeing = directions[directions @ median >= SAME_UP * np.linalg.norm(median)]
    mean = agreeing.sum(axis=0) if 2 * len(agreeing) > len(directions) else directions.sum(axis=0)
    chosen: Vector = mean if np.linalg.norm(mean) > 1e-3 * len(directions) else directions[0]
    return chosen / np.linalg.norm(chosen)


def quarter_turns(camera: Camera, up: Vector) -> int:
    """Return how many counterclockwise quarter turns, 0 to 3, bring an image nearest to upright.

    0 for a camera that looks nearly along the up direction, `[3]` in world axes.
    """
    right, down, _ = camera.world_to_camera[:3, :3].numpy() @ up
    if np.hypot(right, down) < _LEAST_TILT:
        return 0
    return round(float(np.arctan2(right, -down)) / (np.pi / 2)) % 4


def turned(camera: Camera, quarters: int) -> Camera:
    """Return the camera of an image after counterclockwise quarter turns, `torch.rot90(image, quarters)`."""
    step = torch.tensor([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).double()
    for _ in range(quarters):
        camera = replace(
            camera,
            world_to_camera=step @ camera.world_to_camera,
            fx=camera.fy,
            fy=camera.fx,
            cx=camera.cy,
            cy=camera.width - camera.cx,
            width=camera.height,
            height=camera.width,
        )
    return camera


def upright_rotation(cameras: Sequence[Camera]) -> Rotation:
    """Return the rotation from world axes to x right, y up, z back, as seen from the first camera.

    Up is that of the one or more cameras (`upwards`); the viewing direction becomes horizontal.
    """
    from scipy.spatial.transform import Rotation

    up = upwards(cameras)
    first = cameras[0].world_to_camera.numpy()
    back = -first[2, :3] + (first[2, :3] @ up) * up
    if np.linalg.norm(back) < 1e-3:  # looks straight up or down; its x axis is horizontal
        back = np.cross(first[0, :3], up)
    back /= np.linalg.norm(back)
    rotation: Rotation = Rotation.from_matrix(np.stack([np.cross(up, back), up, back]))
    return rotation
