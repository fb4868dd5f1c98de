"""Depths that other views contradict: they see past the point, or another colour in its place.

Two views agree by chance where little texture tells depths apart; the other views outvote them. Votes by
free space are those of Merrell et al., "Real-Time Visibility-Based Fusion of Depth Maps" (ICCV 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from registry.toolkit.photos import in_parallel

from ..image_filters import lowest_and_highest
from ..other_views import FREE_SPACE
from ..projection import inside, lift, pixel_centers, project
from ..witnesses import witnesses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera
    from registry import TrainingView

    from ..projection import DepthImage, Floats, Mask

    Colors = NDArray[np.float32]

COLOR_WINDOW = 7
"""Pixels; a colour is looked for in a square of that width, since depths are not exact."""
COLOR_RANGE = 0.2
"""By how much a channel may lie beyond the colours found there: for gloss, shade and exposure."""

WIDEST_ANGLE = 45.0
"""Degrees between two lines of sight to a point up to which what one sees the other mostly does."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one view can say about points.

    Args:
        camera: the view's.
        depth: `[H, W]` what other views confirm, 0 elsewhere.
        lowest, highest: `[H, W, 3]` of each channel around each pixel.
    """

    camera: Camera
    depth: DepthImage
    lowest: Colors
    highest: Colors

    @classmethod
    def of(cls, view: TrainingView, confirmed: DepthImage) -> Self:
        """The evidence of a view whose depths `[H, W]` are confirmed, 0 where they are not."""
        return cls(view.camera, confirmed, *lowest_and_highest(view.image.numpy(), COLOR_WINDOW))

    def votes(
        self, points: Floats, colors: Colors, photographed_by: Camera
    ) -> tuple[Mask, Mask, Mask]:
        """Which points `[..., 3]` the view sees past, shows in another colour, or confirms.

        Colours count only where the view has no depth, which would tell more, and where it looks from
        nearly the same side: from another the object itself may hide the point.

        Args:
            colors: `[..., 3]` of the points.
            photographed_by: the camera that saw these colours.
        """
        u, v, z = project(self.camera, points)
        within = (z > 0) & inside(self.camera, u, v)
        column, row = np.where(within, u, 0).astype(np.intp), np.where(within, v, 0).astype(np.intp)
        seen = self.depth[row, column]
        beyond = np.maximum(self.lowest[row, column] - colors, colors - self.highest[row, column])
        past = within & (seen > (1 + FREE_SPACE) * z)
        asked = within & (seen == 0) & _from_one_side(points, self.camera, photographed_by)
        miscolored = asked & (beyond > COLOR_RANGE).any(axis=-1)
        confirmed = within & (np.abs(seen - z) <= FREE_SPACE * z)
        return past, miscolored, confirmed


def without_outvoted(
    views: Sequence[TrainingView], depths: Sequence[DepthImage], bounds: tuple[float, float]
) -> list[DepthImage]:
    """The depths `[H, W]` of each view, 0 where more views contradict than confirm.

    Where no depth at all would be left, the photographs' colours are not comparable: nothing falls.

    Args:
        depths: which two views or more agree on, 0 elsewhere.
        bounds: (near, far) z-depth of the scene's content, world units.
    """
    cameras = [view.camera for view in views]
    evidence = in_parallel(
        lambda index: Evidence.of(views[index], depths[index]), range(len(views))
    )

    def not_outvoted(index: int) -> DepthImage:
        view, depth = views[index], depths[index]
        points = lift(view.camera, *pixel_centers(view.camera), depth)
        balance = np.zeros(depth.shape, dtype=np.intp)
        for other in witnesses(cameras, index, bounds):
            past, miscolored, confirmed = evidence[other].votes(
                points, view.image.numpy(), view.camera
            )
            balance += confirmed.astype(np.intp) - past - miscolored
        return np.where(balance < 0, np.float32(0), depth)

    kept = in_parallel(not_outvoted, range(len(views)))
    return kept if any(depth.any() for depth in kept) else list(depths)


def miscolored(
    points: Floats, colors: Colors, photographed_by: Camera, evidence: Sequence[Evidence]
) -> Mask:
    """Which points have a colour that a view does not show in their place; as `Evidence.votes`."""
    result = np.zeros(points.shape[:-1], dtype=np.bool_)
    for view in evidence:
        result |= view.votes(points, colors, photographed_by)[1]
    return result


def _from_one_side(points: Floats, one: Camera, other: Camera) -> Mask:
    """Which points `[..., 3]` two cameras look at under an angle below `WIDEST_ANGLE`."""
    a, b = (points - camera.center.numpy() for camera in (one, other))
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    near: Mask = (a * b).sum(axis=-1) > np.cos(np.radians(WIDEST_ANGLE)) * lengths
    return near
