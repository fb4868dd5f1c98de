"""A smooth flight between cameras, for videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from core_rasterizer import Camera

from ...errors import RunError


def smooth_path(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Cameras on a path through all given ones and back to the first.

    Centres follow a cubic spline, rotations a spline of angular velocity (Park & Ravani 1997, as in
    scipy), focal lengths and principal points straight lines; the size is the first camera's.

    Args:
        cameras: at least two, in the order in which they are visited.
        frames: how many cameras to return, >= 2.

    Raises:
        RunError: fewer cameras or frames than that.
    """
    if len(cameras) < 2 or frames < 2:
        raise RunError(
            f"no path leads through {len(cameras)} camera(s) in {frames} frame(s)",
            fix="use a scene with two or more training views, and two or more frames",
        )
    stops = [*cameras, cameras[0]]
    poses = np.stack([camera.camera_to_world.numpy() for camera in stops])
    times = np.arange(len(stops))
    at = np.linspace(0, len(stops) - 1, frames, endpoint=False)
    centers = CubicSpline(times, poses[:, :3, 3], bc_type="periodic")(at)
    rotations = RotationSpline(times, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    first = cameras[0]
    lenses = np.array(
        [
            [c.fx * x, c.fy * y, c.cx * x, c.cy * y]
            for c in stops
            for x, y in [(first.width / c.width, first.height / c.height)]
        ]
    )
    lens_at = np.stack([np.interp(at, times, column) for column in lenses.T], axis=1)
    path = []
    for center, rotation, (fx, fy, cx, cy) in zip(centers, rotations, lens_at, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ center
        path.append(
            replace(first, world_to_camera=torch.from_numpy(pose), fx=fx, fy=fy, cx=cx, cy=cy)
        )
    return path
