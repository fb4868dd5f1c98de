"""The group-wise correlation volume between two feature maps (Guo et al., CVPR 2019, section 3.2)."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import normalize


def group_correlation(
    left: Tensor, right: Tensor, *, groups: int, candidates: int, normalized: bool
) -> Tensor:
    """How well left(x) fits right(x - k), for each group of channels and each shift k.

    Args:
        left, right: `[N, C, H, W]` features; C is a multiple of `groups`.
        groups: the C channels are split into this many runs of equal length.
        candidates: shifts 0 to candidates - 1, in columns of the feature map.
        normalized: scale each group's vector to length 1, so that the product is a cosine.

    Returns:
        `[N, groups, candidates, H, W]` float32: dot products; 0 where x < k.
    """
    count, channels, height, width = left.shape
    split = (count, groups, channels // groups, height, width)
    left, right = left.reshape(split), right.reshape(split)
    if normalized:
        left, right = normalize(left, dim=2), normalize(right, dim=2)
    volume = left.new_zeros(count, groups, candidates, height, width)
    for shift in range(min(candidates, width)):
        product = left[..., shift:] * right[..., : width - shift]
        volume[:, :, shift, :, shift:] = product.sum(dim=2)
    return volume
