"""A wall with a pattern that three cameras see from the side, for tests of matching."""

from __future__ import annotations

import hashlib

import torch
from torch import Tensor

from core_rasterizer import Camera, Device
from core_rasterizer.matching import PatchMatch
from tests.core_rasterizer.test_plane_sweep import pose

BOUNDS = (2.0, 8.0)
OTHERS = [[1, 2], [0, 2], [0, 1]]
NORMAL = torch.tensor([0.5, -0.2, -0.84], dtype=torch.float64)
"""Of a wall through (0, 0, 4), which the first camera sees at 33 degrees from its normal."""


def wall() -> tuple[list[Tensor], list[Camera], list[Tensor]]:
    """Images `[H, W]`, cameras, and depths of a wall with a pattern, from up to 28 degrees apart."""
    poses = [pose(0, 0, 0, 0, 0), pose(1.0, 0.1, 0.1, -0.25, 0), pose(-1.0, -0.2, 0, 0.25, 0.05)]
    cameras = [Camera.centered(matrix, 70, 64, 48) for matrix in poses]
    images, depths = [], []
    for camera in cameras:
        u, v = camera.pixel_centers()
        rays = camera.unproject(u, v, torch.ones_like(u)) - camera.center
        start = torch.tensor([0.0, 0.0, 4.0], dtype=torch.float64) - camera.center
        depth = (start @ NORMAL) / (rays @ NORMAL)
        x, y, _ = (camera.center + depth[..., None] * rays).unbind(-1)
        waves = (3.1, 0.7), (-1.3, 4.1), (7.3, 5.2), (-9.1, 8.3), (2.2, -11.7)
        pattern = sum(torch.sin(a * x + b * y + a) for a, b in waves)
        images.append((0.5 + 0.1 * torch.as_tensor(pattern)).float())
        depths.append(depth)
    return images, cameras, depths


def matching_digest(device: Device) -> str:
    """Digest of PatchMatch's result."""
    images, cameras, _ = wall()
    digest = hashlib.sha256()
    for found in PatchMatch(device, images, cameras, BOUNDS).maps(OTHERS):
        for values in (found.depth, found.normal, found.cost):
            digest.update(values.contiguous().numpy().tobytes())
    return digest.hexdigest()
