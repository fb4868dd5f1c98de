"""Depths of one training view, with facts and a picture for the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from registry import TrainingView
from registry.priors import DepthMap
from registry.toolkit.drawing import nearness_picture, side_by_side

if TYPE_CHECKING:
    from core_rasterizer import Camera

    from .projection import Colors, DepthImage


PICTURE_COLUMNS = ("photograph", "depth by the prior", "confirmed by other views", "completed")
"""Columns of `ViewDepth.picture`, from left to right."""


@dataclass(frozen=True, eq=False)
class ViewDepth:
    """Depths of one training view, `[H, W]` each, 0 where unknown.

    Args:
        view: the view.
        prior: depths of the prior.
        confirmed: depths that other views confirm.
        filled: guesses for unconfirmed pixels.
    """

    view: TrainingView
    prior: DepthImage
    confirmed: DepthImage
    filled: DepthImage

    @property
    def camera(self) -> Camera:
        """Camera of the view."""
        return self.view.camera

    @property
    def image(self) -> Colors:
        """Photograph `[H, W, 3]`."""
        return self.view.image.numpy()

    @property
    def completed(self) -> DepthImage:
        """Confirmed depths, and guesses elsewhere."""
        return np.where(self.confirmed > 0, self.confirmed, self.filled)

    def confirmed_map(self) -> DepthMap:
        """Confirmed depths of `solid` pixels, all with confidence 1, for other components."""
        depth = torch.from_numpy(self.confirmed)
        if self.view.solid is not None:
            depth = depth.where(self.view.solid, 0.0)
        return DepthMap(depth, depth > 0, (depth > 0).float())

    def facts(self) -> dict[str, Any]:
        """Shares of the view's pixels, and quantiles of its confirmed depths in world units."""
        confirmed = self.confirmed[self.confirmed > 0]
        quantiles = np.quantile(confirmed, (0.05, 0.5, 0.95)) if len(confirmed) else ()
        return {
            "coverage": _share(self.prior),
            "consistent": _share(self.confirmed),
            "filled": _share(self.filled),
            "depth_quantiles": [float(f"{q:.5g}") for q in quantiles],
        }

    def picture(self) -> Tensor:
        """The `PICTURE_COLUMNS` side by side; all depths share one colour scale."""
        depths = torch.from_numpy(
            np.concatenate([self.prior, self.confirmed, self.completed], axis=1)
        )
        known = depths > 0
        nearness = torch.where(known, 1 / depths.where(known, 1.0), 0.0)
        return side_by_side(self.view.image, *nearness_picture(nearness, known).chunk(3, dim=1))


def _share(depth: DepthImage) -> float:
    return round(float((depth > 0).mean()), 4)
