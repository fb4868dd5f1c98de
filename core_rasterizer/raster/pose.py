"""The gradient of the camera's pose, from what the kernels add up. See `kernels/pose.cl`."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera

POSE_NUMBERS = 16
"""Numbers that a block of Gaussians adds up: rotation 9, translation 3, view directions 3, none."""
POSE_CHUNKS = 256
"""Runs of blocks that are added up side by side; fixed, so that the order of the sum is too."""

_LARGEST = 1e37
"""What reaches it is no gradient and becomes 0, as in the kernels."""


def pose_gradient(chunk_sums: Tensor, camera: Camera) -> Tensor:
    """The gradient of `world_to_camera`, its twelve numbers taken on their own.

    The camera centre c = -R^T t is where colours are seen from. With h the sum of dL/d(mean) along the
    view directions, dL/dc = -h, so that t h^T is added to dL/dR and R h to dL/dt.

    Args:
        chunk_sums: `[POSE_CHUNKS * POSE_NUMBERS]` from the kernel `sum_poses`.

    Returns:
        `[4, 4]` float64; the last row is zero.
    """
    sums = chunk_sums[: POSE_CHUNKS * POSE_NUMBERS].double().reshape(POSE_CHUNKS, POSE_NUMBERS)
    rotation_sum, translation_sum, view_sum, _ = sums.sum(dim=0).split((9, 3, 3, 1))
    pose = camera.world_to_camera.detach()
    rotation, translation = pose[:3, :3], pose[:3, 3]
    gradient = torch.zeros(4, 4, dtype=torch.float64)
    gradient[:3, :3] = rotation_sum.reshape(3, 3) + torch.outer(translation, view_sum)
    gradient[:3, 3] = translation_sum + rotation @ view_sum
    return torch.where(gradient.abs() < _LARGEST, gradient, 0.0)
