"""Geometry of correspondences: epipolar distances of matches, consistency and size of optical flow."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

    from ...contract.scene import Matches


def epipolar_distances(matches: Matches, first: Camera, second: Camera) -> Tensor:
    """Return the distance of each match from its epipolar lines, `[M]` float64 pixels.

    The larger of the distances in the two images (Hartley and Zisserman, "Multiple View Geometry", 2004,
    ch. 9 and 11); 0 if both cameras have the same center.
    """
    import torch

    relative = second.world_to_camera @ torch.linalg.inv(first.world_to_camera)
    moved = relative[:3, 3]
    essential = torch.linalg.cross(moved[:, None].expand(3, 3), relative[:3, :3], dim=0)
    fundamental = (
        torch.linalg.inv(second.intrinsics).T @ essential @ torch.linalg.inv(first.intrinsics)
    )
    here, there = (
        torch.cat([points.double(), points.new_ones(len(points), 1).double()], dim=1)
        for points in (matches.first, matches.second)
    )
    in_second, in_first = here @ fundamental.T, there @ fundamental
    error = (there * in_second).sum(dim=1).abs()
    distances = [error / line[:, :2].norm(dim=1) for line in (in_first, in_second)]
    return torch.maximum(*distances).nan_to_num(nan=0.0)


def flow_cycle_error(flow: Tensor, back: Tensor) -> Tensor:
    """Return the forward-backward error of an optical flow; it is large where the flow is wrong or occluded.

    Args:
        flow: `[H, W, 2]` pixels (along columns, along rows) from the first image to the second.
        back: The reverse flow, of the same size; sampled bilinearly.

    Returns:
        `[H, W]` float64 pixels between each pixel and its position after both flows; infinite for
        pixels that leave the image.
    """
    import torch
    from torch.nn.functional import grid_sample

    height, width = flow.shape[:2]
    size = torch.tensor([width, height], dtype=torch.float64)
    ends = _positions(height, width) + flow
    inside = ((ends >= 0) & (ends <= size)).all(dim=2)
    sampled = grid_sample(
        back.double().permute(2, 0, 1)[None],
        (2 * ends / size - 1)[None],
        align_corners=False,
        padding_mode="border",
    )[0].permute(1, 2, 0)
    return torch.where(inside, torch.linalg.vector_norm(flow + sampled, dim=2), torch.inf)


def flow_in_size(flow: Tensor, size: tuple[int, int]) -> Tensor:
    """Convert a flow to a second image that was resized to the first one's size, to its original size.

    Args:
        flow, size: `[H, W, 2]` pixels; `(height, width)` of the second image.

    Returns:
        `[H, W, 2]` float64: pixel (u, v) of the first image is at (u, v) + flow in the second.
    """
    height, width = flow.shape[:2]
    here = _positions(height, width)
    factors = here.new_tensor([size[1] / width, size[0] / height])
    return (here + flow) * factors - here


def _positions(height: int, width: int) -> Tensor:
    """Return `[H, W, 2]` float64 pixel centers (column, row); the first is (0.5, 0.5)."""
    import torch

    axes = (torch.arange(count, dtype=torch.float64) + 0.5 for count in (height, width))
    rows, columns = torch.meshgrid(*axes, indexing="ij")
    return torch.stack([columns, rows], dim=2)
