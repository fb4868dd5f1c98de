"""`depth_ranking`: of two pixels, the one that a prior takes to be nearer must be rendered nearer.

SparseNeRF (Wang et al., ICCV 2023), on Gaussians: order survives the unknown scale of
monocular depth. Pixels that the prior takes to be at one depth are to be rendered at one depth too.
MVPGS (Xu et al. 2024) compares pairs from anywhere in the image, without margin or continuity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Regularizer, Settings, Step

from .estimate import Farness

if TYPE_CHECKING:
    from torch import Tensor

NEIGHBOUR_REACH = 3
"""Pixels in rows and columns within which a pixel's partner at the same depth is looked for."""
CANDIDATES = 8
"""Of the neighbours, drawn at random; the one that the prior takes to be most alike is compared."""


class DepthRankingSettings(Settings):
    prior: str | None = None
    """Name of a monocular or multi-view depth prior; null takes the only one, monocular ones first."""
    pairs: int = Field(4096, ge=1)
    """Drawn in each iteration. MVPGS: 512."""
    reach: int | None = Field(32, ge=1)
    """Largest distance of a pair in rows and in columns, pixels; null: anywhere in the image."""
    margin: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """By how much a pair may disagree, in units of the geometric mean of the scene's near and far."""
    continuity: float = Field(0.01, ge=0, allow_inf_nan=False)
    """Weight of the part that keeps alike pixels together. SparseNeRF: 0.01 on LLFF, 1 on DTU."""


class DepthRanking(Regularizer[DepthRankingSettings]):
    """mean max(0, D_near - D_far + margin) + continuity times, for both pixels of the pair,
    mean max(0, |D - D_neighbour| - margin); D is depth as blended over sqrt(near far). What is not `solid` in
    a photograph with an alpha has no place in the order.
    """

    needs_priors = (("monocular_depth", "multi_view_depth"),)

    def __init__(self, settings: DepthRankingSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._farness = Farness(settings.prior)

    def loss(self, step: Step) -> Tensor:
        """The term for the view at hand; pairs whose order is unknown or equal count as 0."""
        settings = self.settings
        farness, known = self._farness.of(step)
        depth = step.rendering.depth / math.sqrt(math.prod(step.scene.bounds))
        first = self._anywhere(known)
        reach = settings.reach
        second = self._anywhere(known) if reach is None else self._beside(first, known, reach)
        order = (farness[first] - farness[second]).sign() * (known[first] & known[second])
        hinge = (order * (depth[second] - depth[first]) + settings.margin).clamp(min=0)
        loss = (hinge * (order != 0)).mean()
        if settings.continuity:
            for pixels in (first, second):
                loss = loss + settings.continuity * self._discontinuity(
                    depth, farness, known, pixels
                )
        return loss

    def _discontinuity(
        self, depth: Tensor, farness: Tensor, known: Tensor, pixels: tuple[Tensor, Tensor]
    ) -> Tensor:
        import torch

        wide = (pixels[0].repeat(CANDIDATES), pixels[1].repeat(CANDIDATES))
        candidates = self._beside(wide, known, NEIGHBOUR_REACH)
        unlike = (farness[wide] - farness[candidates]).abs()
        # A pixel is no neighbour of itself.
        itself = (wide[0] == candidates[0]) & (wide[1] == candidates[1])
        usable = known[wide] & known[candidates] & ~itself
        unlike = torch.where(usable, unlike, torch.inf).reshape(CANDIDATES, -1)
        least = unlike.min(dim=0)
        alike = tuple(
            index.reshape(CANDIDATES, -1).gather(0, least.indices[None])[0] for index in candidates
        )
        apart = ((depth[pixels] - depth[alike]).abs() - self.settings.margin).clamp(min=0)
        return (apart * least.values.isfinite()).mean()

    def _anywhere(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Rows and columns of random pixels."""
        import torch

        rows, columns = (
            torch.randint(size, (self.settings.pairs,), generator=self.generator)
            for size in like.shape
        )
        return rows, columns

    def _beside(
        self, pixels: tuple[Tensor, Tensor], like: Tensor, reach: int
    ) -> tuple[Tensor, Tensor]:
        """Random pixels at most `reach` rows and columns away, within the image."""
        import torch

        rows, columns = (
            (index + torch.randint(-reach, reach + 1, index.shape, generator=self.generator)).clamp(
                0, size - 1
            )
            for index, size in zip(pixels, like.shape, strict=True)
        )
        return rows, columns
