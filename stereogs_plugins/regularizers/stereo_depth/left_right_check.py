"""Left-right consistency check of stereo disparities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from registry.priors import Disparity


def agreeing(left: Disparity, right: Disparity, tolerance: float) -> Tensor:
    """Return where the disparities of both images agree, bool `[H, W]`; other pixels are occluded or wrong.

    |D_l(u, v) - D_r(u - D_l(u, v), v)| <= tolerance (StereoGS), with D_r bilinear in u. A pixel whose
    match is outside the right image, or invalid there, does not agree.

    Args:
        left, right: positive disparities `[H, W]`, each on its own image's grid.
        tolerance: pixels.
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
