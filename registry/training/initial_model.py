"""The initial Gaussians from points."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import Device, Engine, Gaussians, Model, OpenCLEngine

from ..contract.scene import PointCloud
from ..pipeline.training_settings import TrainingSettings

NEIGHBOURS = 3
"""Number of nearest points whose distance gives the initial size of a Gaussian (3DGS)."""
MIN_SQUARED_DISTANCE = 1e-7
"""Square world units, so that coincident points get a size (3DGS)."""


def initial_gaussians(points: PointCloud, settings: TrainingSettings) -> Gaussians:
    """Return Gaussians with the properties of the points, isotropic where these have one scale or none.

    Args:
        points: at least one, checked (`check_initialization`).
    """
    scales, opacities = points.scales, points.opacities
    if scales is None:
        scales = settings.initial_scale * mean_squared_distances(points.positions).sqrt().float()
    if opacities is None:
        opacities = torch.full((len(points),), settings.initial_opacity)
    return Gaussians.from_points(
        points.positions,
        points.colors,
        scales,
        opacities,
        settings.sh_degree,
        points.quaternions,
        points.sh,
    )


def new_model(gaussians: Gaussians, settings: TrainingSettings, device: Device | Engine) -> Model:
    """Return Gaussians in an engine, with the rendering options of the settings.

    Args:
        device: stands for its OpenCL engine.

    Raises:
        GaussianError: a parameter is not finite.
    """
    engine = OpenCLEngine(device) if isinstance(device, Device) else device
    return engine.model(
        gaussians,
        dilation=settings.dilation,
        compensate_dilation=settings.compensate_dilation,
    )


def mean_squared_distances(positions: Tensor) -> Tensor:
    """Return the mean squared distance to the three nearest other points, `[N]` float64, at least 1e-7.

    With fewer than four points, the mean is over all others; for a single point it is 1e-7.

    Args:
        positions: `[N, 3]`, world units, N >= 1.
    """
    from scipy.spatial import KDTree  # slow import, not needed for points with sizes

    neighbours = min(NEIGHBOURS, len(positions) - 1)
    if neighbours == 0:
        return torch.full((1,), MIN_SQUARED_DISTANCE, dtype=torch.float64)
    array = positions.double().numpy()
    distances, _ = KDTree(array).query(array, k=neighbours + 1)
    # The nearest is the point itself or a duplicate, at distance 0.
    squared = torch.from_numpy(distances[:, 1:] ** 2)
    return squared.mean(dim=1).clamp(min=MIN_SQUARED_DISTANCE)
