"""Estimates of prior models: maps of pixels, and matches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, eq=False)
class Disparity:
    """Disparity of a rectified pair on the pixels of one of its images.

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
    """Optical flow from one image to another.

    Args:
        vectors: `[H, W, 2]` float32 pixels (along columns, along rows); 0 where not valid. Pixel (u, v)
            of the first image corresponds to (u, v) + vectors[v, u] in the second.
        valid: `[H, W]` bool.
    """

    vectors: Tensor
    valid: Tensor


@dataclass(frozen=True, eq=False)
class Matches:
    """Corresponding points of two images.

    Args:
        first, second: `[M, 2]` float32 pixel positions (column, row) in the first and in the second
            image; the centre of the first pixel is (0.5, 0.5).
        scores: `[M]` float32 in [0, 1], confidence of each match.
    """

    first: Tensor
    second: Tensor
    scores: Tensor
