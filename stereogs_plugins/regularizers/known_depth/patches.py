"""Square patches of a map, normalized by what they and the whole map spread."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from torch import Tensor

SHARE_OF_IMAGE = 0.01
"""Of the image's standard deviation, added to a patch's own: flat patches are not blown up."""
SMALLEST = 1e-8
"""Added to variances before their root, whose slope at 0 has no end, and to what is divided by."""


class Patches:
    """The patches that fit side by side into a map, from its first row and column on.

    Args:
        image: `[H, W]`.
        known: `[H, W]` bool; other pixels take no part in means and spreads.
        side: pixels, at most H and W.

    Attributes:
        values, known: `[P, side * side]`; in a patch with fewer than two known pixels none is.
    """

    def __init__(self, image: Tensor, known: Tensor, side: int) -> None:
        self.values = _cut(image, side)
        self.known = _cut(known, side)
        self.known = self.known & (self.known.sum(dim=1, keepdim=True) >= 2)
        self._spread = _spread(image[known][None], known[known][None])[0]

    def normalized(self, form: Literal["local", "global"]) -> Tensor:
        """Each patch without its mean, in units of its own or of the image's spread; 0 where unknown."""
        count = self.known.sum(dim=1, keepdim=True).clamp(min=1)
        mean = (self.values * self.known).sum(dim=1, keepdim=True) / count
        centred = (self.values - mean) * self.known
        if form == "global":
            return centred / (self._spread.detach() + SMALLEST)
        own = _spread(self.values, self.known)
        return centred / (own + SHARE_OF_IMAGE * self._spread + SMALLEST)


def _cut(image: Tensor, side: int) -> Tensor:
    return image.unfold(0, side, side).unfold(1, side, side).reshape(-1, side * side)


def _spread(values: Tensor, known: Tensor) -> Tensor:
    """Standard deviation `[P, 1]` of the known ones, with n - 1 as torch has it."""
    count = known.sum(dim=1, keepdim=True)
    mean = (values * known).sum(dim=1, keepdim=True) / count.clamp(min=1)
    squares = ((values - mean) * known).square().sum(dim=1, keepdim=True)
    return (squares / (count - 1).clamp(min=1) + SMALLEST**2).sqrt()
