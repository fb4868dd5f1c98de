"""How well matches keep to two known cameras."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

    from ...contract.maps import Matches


def epipolar_distances(matches: Matches, first: Camera, second: Camera) -> Tensor:
    """`[M]` float64 pixels from each match's points to the lines on which the cameras put them.

    The larger of the two distances, in the first and in the second image (Hartley and Zisserman,
    "Multiple View Geometry", 2004, ch. 9 and 11). 0 where two cameras in one place tell no line.
    """
    import torch

    relative = second.world_to_camera @ torch.linalg.inv(first.world_to_camera)
    moved = relative[:3, 3]
    essential = torch.linalg.cross(moved[:, None].expand(3, 3), relative[:3, :3], dim=0)
    fundamental = (
        torch.linalg.inv(second.intrinsics).T @ essential @ torch.linalg.inv(first.intrinsics)
    )
    here, there = (_homogeneous(points) for points in (matches.first, matches.second))
    in_second, in_first = here @ fundamental.T, there @ fundamental
    error = (there * in_second).sum(dim=1).abs()
    distances = [error / line[:, :2].norm(dim=1) for line in (in_first, in_second)]
    return torch.maximum(*distances).nan_to_num(nan=0.0)


def _homogeneous(points: Tensor) -> Tensor:
    import torch

    return torch.cat([points.double(), points.new_ones(len(points), 1).double()], dim=1)
