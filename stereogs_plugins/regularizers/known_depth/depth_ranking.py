"""`depth_ranking`: rendered depth must have the same order as a depth prior.

SparseNeRF (Wang et al., ICCV 2023), on Gaussians: the order of depths does not depend on the unknown scale of
monocular depth. Neighbouring pixels with equal prior depth must also have equal rendered depth.
MVPGS (Xu et al. 2024) compares pairs from the whole image, without margin or continuity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, HostDefaults, Regularizer, Settings, Step

from .estimate import Farness

if TYPE_CHECKING:
    from torch import Tensor

NEIGHBOUR_REACH = 3
"""Largest distance of candidate neighbours in rows and columns, pixels."""
CANDIDATES = 8
"""Number of random neighbours; the one with the most similar prior depth is compared."""


class DepthRankingSettings(Settings):
    prior: str | None = None
    """Name of a monocular or multi-view depth prior; null uses the only one, monocular first."""
    pairs: int = Field(4096, ge=1)
    """Number of pairs per iteration. MVPGS: 512."""
    reach: int | None = Field(32, ge=1)
    """Largest distance of a pair in rows and in columns, pixels; null: unlimited."""
    margin: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """Margin of the hinge, in units of the geometric mean of the scene's near and far bounds."""
    continuity: float = Field(0.01, ge=0, allow_inf_nan=False)
    """Weight of the continuity loss between similar pixels. SparseNeRF: 0.01 on LLFF, 1 on DTU."""


class DepthRanking(Regularizer[DepthRankingSettings]):
    """mean max(0, D_near - D_far + margin) + continuity times, for both pixels of the pair,
    mean max(0, |D - D_neighbour| - margin); D is depth as blended over sqrt(near far). In photographs with
    alpha only `solid` pixels are compared.
    """

    needs_priors = (("monocular_depth", "multi_view_depth"),)
    host_defaults = HostDefaults(weight=0.5)

    def __init__(self, settings: DepthRankingSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._farness = Farness(settings.prior)

    def loss(self, step: Step) -> Tensor:
        """Return the loss for the iteration's view; pairs of unknown or equal order count as 0."""
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
        difference = (farness[wide] - farness[candidates]).abs()
        itself = (wide[0] == candidates[0]) & (wide[1] == candidates[1])
        usable = known[wide] & known[candidates] & ~itself
        difference = torch.where(usable, difference, torch.inf).reshape(CANDIDATES, -1)
        least = difference.min(dim=0)
        similar = tuple(
            index.reshape(CANDIDATES, -1).gather(0, least.indices[None])[0] for index in candidates
        )
        gap = ((depth[pixels] - depth[similar]).abs() - self.settings.margin).clamp(min=0)
        return (gap * least.values.isfinite()).mean()

    def _anywhere(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Return rows and columns of random pixels."""
        import torch

        rows, columns = (
            torch.randint(size, (self.settings.pairs,), generator=self.generator)
            for size in like.shape
        )
        return rows, columns

    def _beside(
        self, pixels: tuple[Tensor, Tensor], like: Tensor, reach: int
    ) -> tuple[Tensor, Tensor]:
        """Return random pixels at most `reach` rows and columns away, within the image."""
        import torch

        rows, columns = (
            (index + torch.randint(-reach, reach + 1, index.shape, generator=self.generator)).clamp(
                0, size - 1
            )
            for index, size in zip(pixels, like.shape, strict=True)
        )
        return rows, columns
