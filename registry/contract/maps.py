"""What prior models know of images: maps of every pixel, and points that match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the pixels of one image went in another.

    Args:
        vectors: `[H, W, 2]` float32 pixels (along columns, along rows); 0 where not valid. What pixel
            (u, v) of the first image shows is at (u, v) + vectors[v, u] in the second.
        valid: `[H, W]` bool.
    """

    vectors: Tensor
    valid: Tensor


@dataclass(frozen=True, eq=False)
class Matches:
    """Points of two images that show the same.

    Args:
        first, second: `[M, 2]` float32 pixel positions (column, row) in the first and in the second
            image; the middle of the first pixel is (0.5, 0.5).
        scores: `[M]` float32 in [0, 1], how sure each match is.
    """

    first: Tensor
    second: Tensor
    scores: Tensor
