"""Which way is up in a scene, as the people who took the photographs held their cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from core_rasterizer import Camera

Vector = NDArray[np.float64]


def upwards(cameras: Sequence[Camera]) -> Vector:
    """The mean of the directions that are up in the images, `[3]`, unit length, world axes.

    Where they cancel out, the first camera's.

    Args:
        cameras: at least one.
    """
    directions = np.stack([-camera.world_to_camera[1, :3].numpy() for camera in cameras])
    mean = directions.mean(axis=0)
    chosen: Vector = mean if np.linalg.norm(mean) > 1e-3 else directions[0]
    return chosen / np.linalg.norm(chosen)


def upright_rotation(cameras: Sequence[Camera]) -> Rotation:
    """The rotation from world axes to x right, y up, z back for someone who stands at the first camera.

    Up is the mean of all cameras (`upwards`); the direction of view becomes level.

    Args:
        cameras: at least one.
    """
    up = upwards(cameras)
    first = cameras[0].world_to_camera.numpy()
    back = -first[2, :3] + (first[2, :3] @ up) * up
    if np.linalg.norm(back) < 1e-3:  # it looks straight up or down: its image's x axis is level
        back = np.cross(first[0, :3], up)
    back /= np.linalg.norm(back)
    rotation: Rotation = Rotation.from_matrix(np.stack([np.cross(up, back), up, back]))
    return rotation
