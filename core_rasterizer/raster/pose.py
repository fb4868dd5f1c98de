"""The gradient of the camera's pose, from the sums of `kernels/pose.cl`."""

from __future__ import annotations

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray, Program, Scratch
from ..layout import LARGEST, POSE
from .block import Block

_CHUNKS = 256
"""Runs of blocks that are summed in parallel; constant, for a fixed order of summation."""


class PoseSums:
    """Sums of the pose gradient over blocks of Gaussians.

    Args:
        device: where the kernels run.
        wide: type of the sums, `wide` of the kernels.
    """

    def __init__(self, device: Device, wide: torch.dtype) -> None:
        self._device, self._wide = device, wide
        self._scratch = Scratch(device)

    def parts(self, block: Block) -> DeviceArray:
        """Output of the projection's backward pass: a `POSE` per block of Gaussians."""
        rows = block.capacity // self._device.lanes
        return self._scratch.reserve("parts", self._wide, rows * POSE.size)

    def gradient(self, program: Program, block: Block, camera: Camera) -> Tensor:
        """The gradient of `world_to_camera`, `[4, 4]` float64, from `parts`."""
        sums = self._scratch.reserve("sums", self._wide, _CHUNKS * POSE.size)
        program.run(
            "sum_poses",
            (_CHUNKS, POSE.size),
            (1, POSE.size),
            pose_sums=self.parts(block),
            chunk_sums=sums,
            blocks=-(-block.count // self._device.lanes),
        )
        by_chunk = sums.read()[: _CHUNKS * POSE.size].double().reshape(_CHUNKS, POSE.size)
        return _through_center(by_chunk.sum(dim=0), camera)


def _through_center(sums: Tensor, camera: Camera) -> Tensor:
    """The gradient of the twelve entries of the pose, treated as independent.

    Colours depend on the camera centre c = -R^T t. With h the sum of dL/d(mean) through the view
    directions, dL/dc = -h, which adds t h^T to dL/dR and R h to dL/dt.

    Args:
        sums: `[16]`, a `POSE` over all Gaussians.

    Returns:
        `[4, 4]` float64; the last row is zero.
    """
    rotation_sum, translation_sum, view_sum, _ = sums.split((9, 3, 3, 1))
    pose = camera.world_to_camera.detach()
    rotation, translation = pose[:3, :3], pose[:3, 3]
    gradient = torch.zeros(4, 4, dtype=torch.float64)
    gradient[:3, :3] = rotation_sum.reshape(3, 3) + torch.outer(translation, view_sum)
    gradient[:3, 3] = translation_sum + rotation @ view_sum
    return torch.where(gradient.abs() < LARGEST, gradient, 0.0)
