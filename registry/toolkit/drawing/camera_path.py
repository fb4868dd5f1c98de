"""A smooth camera path for videos, and the up direction of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from core_rasterizer import Camera

from ...errors import RunError

Vector = NDArray[np.float64]


def smooth_path(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Return cameras on a closed path through all given cameras.

    Centers follow a cubic spline, rotations a spline of angular velocity (Park & Ravani 1997, as in
    scipy), focal lengths and principal points linear interpolation; the size is the first camera's.

    Raises:
        RunError: There are fewer than two cameras or frames.
    """
    if len(cameras) < 2 or frames < 2:
        raise RunError(
            f"no path exists through {len(cameras)} camera(s) in {frames} frame(s)",
            fix="use a scene with two or more training views, and two or more frames",
        )
    stops = [*cameras, cameras[0]]
    poses = np.stack([camera.camera_to_world.numpy() for camera in stops])
    times = np.arange(len(stops))
    at = np.linspace(0, len(stops) - 1, frames, endpoint=False)
    centers = CubicSpline(times, poses[:, :3, 3], bc_type="periodic")(at)
    rotations = RotationSpline(times, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    first = cameras[0]
    resized = [camera.resized(first.width, first.height) for camera in stops]
    lenses = np.array([[c.fx, c.fy, c.cx, c.cy] for c in resized])
    lens_at = np.stack([np.interp(at, times, column) for column in lenses.T], axis=1)
    path = []
    for center, rotation, (fx, fy, cx, cy) in zip(centers, rotations, lens_at, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ center
        world_to_camera = torch.from_numpy(pose)
        path.append(replace(first, world_to_camera=world_to_camera, fx=fx, fy=fy, cx=cx, cy=cy))
    return path


def upwards(cameras: Sequence[Camera]) -> Vector:
    """Return the mean up direction of one or more images, `[3]`, unit length, world axes.

    If the directions cancel out, the up direction of the first camera.
    """
    directions = np.stack([-camera.world_to_camera[1, :3].numpy() for camera in cameras])
    mean = directions.mean(axis=0)
    chosen: Vector = mean if np.linalg.norm(mean) > 1e-3 else directions[0]
    return chosen / np.linalg.norm(chosen)


def upright_rotation(cameras: Sequence[Camera]) -> Rotation:
    """Return the rotation from world axes to x right, y up, z back, as seen from the first camera.

    Up is the mean over the one or more cameras (`upwards`); the viewing direction becomes horizontal.
    """
    up = upwards(cameras)
    first = cameras[0].world_to_camera.numpy()
    back = -first[2, :3] + (first[2, :3] @ up) * up
    if np.linalg.norm(back) < 1e-3:  # looks straight up or down; its x axis is horizontal
        back = np.cross(first[0, :3], up)
    back /= np.linalg.norm(back)
    rotation: Rotation = Rotation.from_matrix(np.stack([np.cross(up, back), up, back]))
    return rotation
