"""A real scene for measurements: Gaussians from the points of Mip-NeRF 360's garden."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree

from core_rasterizer import Camera, Gaussians

OPACITY = 0.8
SHAPE = (0.5, 1.5)
"""Range of the factors on a Gaussian's three axes: the rotation of a ball has no gradient."""
VIEW_DEPENDENCE = 0.03
"""Standard deviation of the random SH bands above the constant one."""


def garden() -> tuple[Gaussians, list[Camera]] | None:
    """Return 138,766 Gaussians with the colours of the points, and three cameras of 648x420 pixels.

    A Gaussian's size is the root of the mean squared distance to its three nearest neighbours (3DGS);
    its shape and its rotation are random. None if STEREOGS_DATA does not name a folder that holds the points.
    """
    root = os.environ.get("STEREOGS_DATA")
    file = Path(root, "mip360_garden_points", "test_garden.npz") if root else None
    if file is None or not file.is_file():
        return None
    with np.load(file) as data:
        points = data["means3d"].astype(np.float64)
        colors = torch.from_numpy(data["colors"] / 255.0)
        width, height = int(data["width"]), int(data["height"])
        cameras = [
            Camera(pose, k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
            for pose, k in zip(data["viewmats"], data["Ks"], strict=True)
        ]
    distances, _ = KDTree(points).query(points, k=4)
    scales = np.sqrt((distances[:, 1:] ** 2).mean(axis=1)).clip(min=1e-6)
    gaussians = Gaussians.from_points(
        torch.from_numpy(points),
        colors,
        torch.from_numpy(scales),
        torch.full((len(points),), OPACITY),
        sh_degree=3,
    )
    generator = torch.Generator().manual_seed(0)
    factors = torch.empty(len(points), 3).uniform_(*SHAPE, generator=generator)
    gaussians.log_scales.add_(factors.log())
    gaussians.quaternions.normal_(generator=generator)
    gaussians.sh[:, 1:] = VIEW_DEPENDENCE * torch.randn(len(points), 15, 3, generator=generator)
    return gaussians, cameras
