"""Support by kind: which share of a pixel's light comes from points that several photographs confirmed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from registry.confidence import Confidence, Trained

from .painted import Painted

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

CONFIRMED, FILLED = "confirmed", "filled"


class SupportConfidence(Confidence):
    """Shares of each pixel's light by the kind of the points that the Gaussians descend from.

    Args:
        trained: with the kinds "confirmed" and "filled"; further kinds count as guessed.
    """

    def __init__(self, trained: Trained) -> None:
        none = torch.zeros(trained.model.count, dtype=torch.bool)
        confirmed, filled = (trained.kinds.get(kind, none) for kind in (CONFIRMED, FILLED))
        values = torch.stack([confirmed, filled & ~confirmed], dim=1).float()
        self._painted = Painted(trained.model, values)

    def shares(self, camera: Camera) -> Tensor:
        """Return `[H, W, 2]`, the shares of confirmed and of filled points in each pixel's light."""
        return self._painted.render(camera).clamp(0, 1)

    def of(self, camera: Camera) -> Tensor:
        """Return the share of confirmed points."""
        return self.shares(camera)[..., 0]
