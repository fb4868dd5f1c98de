"""What priors of optical flow share: the way there and back, and images of two sizes."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def flow_cycle_error(flow: Tensor, back: Tensor) -> Tensor:
    """Where a pixel does not come back to itself, the flow is wrong or it is hidden in the second image.

    Args:
        flow: `[H, W, 2]` pixels (along columns, along rows) from the first image to the second.
        back: the same from the second to the first, of the same size; read bilinearly.

    Returns:
        `[H, W]` float64 pixels between where each pixel is and where it comes back to; infinite
        for pixels that leave the image.
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
    """A flow to a second image that was looked at in the size of the first, in its own size.

    Args:
        flow: `[H, W, 2]` pixels.
        size: `(height, width)` of the second image.

    Returns:
        `[H, W, 2]` float64: pixel (u, v) of the first image is at (u, v) + it in the second.
    """
    height, width = flow.shape[:2]
    here = _positions(height, width)
    factors = here.new_tensor([size[1] / width, size[0] / height])
    return (here + flow) * factors - here


def _positions(height: int, width: int) -> Tensor:
    """`[H, W, 2]` float64, the centre (column, row) of each pixel; the first is (0.5, 0.5)."""
    import torch

    axes = (torch.arange(count, dtype=torch.float64) + 0.5 for count in (height, width))
    rows, columns = torch.meshgrid(*axes, indexing="ij")
    return torch.stack([columns, rows], dim=2)
