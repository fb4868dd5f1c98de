"""Moving pixels between cameras by their depth: forwards, as points, and backwards, by looking them up."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

SHARPNESS = 100.0
"""How clearly the nearer of two points wins: weights are exp(-SHARPNESS * depth / nearest depth)."""


def forward_splat(
    camera: Camera, image: Tensor, depth: Tensor, known: Tensor, target: Camera
) -> tuple[Tensor, Tensor]:
    """What a camera sees of an image whose depth is known, pixels being points.

    Each point is shared among the four pixels around it, bilinearly; points at one pixel are averaged,
    the nearest with by far the most weight (softmax splatting, Niklaus and Liu 2020).

    Args:
        image: `[H, W, 3]`.
        depth: `[H, W]` z-depth, world units.
        known: `[H, W]` bool, the pixels to move.

    Returns:
        `[H', W', 3]` float32 colours, 0 in holes; `[H', W']` bool, True where a point has come.
    """
    import torch

    u, v = camera.pixel_centers()
    points = camera.unproject(u[known], v[known], depth[known])
    u, v, z = target.project(points)
    colors = image[known].double()
    front = z > 0
    u, v, z, colors = u[front] - 0.5, v[front] - 0.5, z[front], colors[front]
    size = target.height * target.width
    nearest = torch.full((size,), torch.inf, dtype=torch.float64)
    shares = []
    for right in (0, 1):
        for down in (0, 1):
            column, row = u.floor() + right, v.floor() + down
            share = (1 - (u - column).abs()) * (1 - (v - row).abs())
            used = target.contains(column, row) & (share > 1e-3)
            place = (row * target.width + column)[used].long()
            nearest.scatter_reduce_(0, place, z[used], "amin")
            shares.append((place, share[used], z[used], colors[used]))
    total = torch.zeros(size, 4, dtype=torch.float64)
    for place, share, distance, color in shares:
        weight = share * torch.exp(-SHARPNESS * (distance / nearest[place] - 1))
        for channel, values in enumerate((weight, *(weight * c for c in color.unbind(1)))):
            total[:, channel] += torch.bincount(place, values, size)
    hit = total[:, 0] > 0
    picture = torch.where(hit[:, None], total[:, 1:] / total[:, :1].clamp(min=1e-300), 0.0)
    shape = (target.height, target.width)
    return picture.float().reshape(*shape, 3), hit.reshape(shape)


def look_up(image: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """An image's values at pixel positions, bilinear between pixel centres, in autograd of all three.

    Args:
        image: `[H, W, C]`.
        u, v: columns and rows `[...]`; the top-left pixel's centre is (0.5, 0.5).

    Returns:
        `[..., C]`; and bool `[...]`, False outside the image, where values are those at its edge.
    """
    import torch
    from torch.nn.functional import grid_sample

    height, width = image.shape[:2]
    with torch.no_grad():
        inside = (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    grid = torch.stack([2 * u / width - 1, 2 * v / height - 1], dim=-1).reshape(1, 1, -1, 2)
    values = grid_sample(
        image.permute(2, 0, 1)[None], grid.to(image), padding_mode="border", align_corners=False
    )
    return values[0, :, 0].T.reshape(*u.shape, image.shape[2]), inside
