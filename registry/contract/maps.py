"""What is known of an image, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, eq=False)
class Disparity:
    """A rectified pair's disparity on the grid of the image that it was asked for.

    Args:
        values: `[H, W]` float32 pixels, > 0 where valid and 0 elsewhere. The left image's pixel
            (u, v) shows what the right image shows at (u - values[v, u], v).
        valid: `[H, W]` bool.
    """

    values: Tensor
    valid: Tensor


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A view's depth.

    Args:
        depth: `[H, W]` float32 z-depth in world units, > 0 where valid and 0 elsewhere.
        valid: `[H, W]` bool.
        confidence: `[H, W]` float32 in [0, 1]; 0 where not valid.
    """

    depth: Tensor
    valid: Tensor
    confidence: Tensor
