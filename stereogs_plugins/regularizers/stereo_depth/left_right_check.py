"""Which pixels of a stereo pair's left image have a disparity to trust: what the right one confirms."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from registry.priors import Disparity


def agreeing(left: Disparity, right: Disparity, tolerance: float) -> Tensor:
    """Where both images' disparities tell the same, bool `[H, W]`; elsewhere something is occluded or wrong.

    |D_l(u, v) - D_r(u - D_l(u, v), v)| <= tolerance (StereoGS), with D_r bilinear in u. A pixel whose
    partner lies outside the right image, or is not known there, does not agree.

    Args:
        left, right: each on its own image's grid, `[H, W]`, both positive.
        tolerance: in pixels.
    """
    width = left.values.shape[1]
    partner = torch.arange(width, dtype=torch.float32) - left.values
    inside = (partner >= 0) & (partner <= width - 1)
    column = partner.floor()
    share = partner - column
    first = column.long().clamp(0, width - 1)
    second = (first + 1).clamp(max=width - 1)
    known = right.valid.gather(1, first) & (right.valid.gather(1, second) | (share == 0))
    sampled = torch.lerp(right.values.gather(1, first), right.values.gather(1, second), share)
    return left.valid & inside & known & ((left.values - sampled).abs() <= tolerance)
