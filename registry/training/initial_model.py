"""The initial Gaussians from points."""

from __future__ import annotations

import json

import torch
from torch import Tensor

from core_rasterizer import Device, Engine, Gaussians, Model, OpenCLEngine

from ..contract.checks.scene import check_points, is_file_name
from ..contract.scene import PointCloud
from ..errors import SceneError
from ..messages.visible_text import is_plain_name
from ..pipeline.training_settings import TrainingSettings
from ..system.files import jsonable

NEIGHBOURS = 3
"""Number of nearest points whose distance gives the initial size of a Gaussian (3DGS)."""
MIN_SQUARED_DISTANCE = 1e-7
"""Square world units, so that coincident points get a size (3DGS)."""
_MAX_FACTS = 1_000_000
"""Characters of the initializer's facts as JSON."""


def initial_gaussians(points: PointCloud, settings: TrainingSettings) -> Gaussians:
    """Return isotropic Gaussians with the positions and colours of the points.

    Args:
        points: at least one.

    Raises:
        SceneError: the points are empty; a position, colour, scale or opacity is out of range; the name of a
            picture is not a file name; or a kind is not a mask of the points.
    """
    _check(points)
    scales, opacities = points.scales, points.opacities
    if scales is None:
        scales = settings.initial_scale * mean_squared_distances(points.positions).sqrt().float()
    if opacities is None:
        opacities = torch.full((len(points),), settings.initial_opacity)
    return Gaussians.from_points(
        points.positions, points.colors, scales, opacities, settings.sh_degree
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


def _check(points: PointCloud) -> None:
    for name in points.pictures:
        if not is_file_name(name):
            raise SceneError(f"the picture {name!r} has no plain file name")
    count = len(points)
    if count == 0:
        raise SceneError(
            "the initializer found no points to start from",
            fix="use more or better overlapping views, or another one: --set initializer.use=random",
        )
    for name, mask in points.kinds.items():
        if not is_file_name(name) or "," in name:
            raise SceneError(f"the kind {name!r} of points has no plain name")
        if mask.dtype != torch.bool or tuple(mask.shape) != (count,):
            raise SceneError(
                f"points.kinds[{name!r}] is {mask.dtype} of shape {tuple(mask.shape)}, "
                f"expected a bool for each of {count} points"
            )
    check_points(points)
    try:
        size = len(json.dumps(jsonable(dict(points.facts))))
    except (TypeError, ValueError) as error:
        raise SceneError(f"the initializer's facts are not plain values: {error}") from error
    if size > _MAX_FACTS or not all(is_plain_name(name) for name in points.facts):
        raise SceneError(
            "the initializer's facts do not have plain names, or take more than a megabyte",
            fix="use printable texts of at most 200 characters as names",
        )
