"""Depths that other views contradict: they see past the point, or another colour in its place.

Two views can agree by chance where texture is weak; the other views outvote them. Free-space votes follow
Merrell et al., "Real-Time Visibility-Based Fusion of Depth Maps" (ICCV 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from registry.toolkit.progress import in_parallel

from ..image_filters import lowest_and_highest
from ..projection import lift, pixel_centers, pixel_of, project
from ..visibility import FREE_SPACE, source_indices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera
    from registry import TrainingView

    from ..projection import Colors, DepthImage, Floats, Mask

COLOR_WINDOW = 7
"""Width of the square in which a colour is searched, pixels, since depths are not exact."""
COLOR_RANGE = 0.2
"""Tolerance of each channel beyond the colours in the square: for gloss, shade and exposure."""
WIDEST_ANGLE = 45.0
"""Largest angle between two lines of sight to a point for their colours to be compared, degrees."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Data of one view for votes on points.

    Args:
        camera: camera of the view.
        depth: `[H, W]` confirmed depth, 0 elsewhere.
        lowest, highest: `[H, W, 3]` range of each channel around each pixel.
    """

    camera: Camera
    depth: DepthImage
    lowest: Colors
    highest: Colors

    @classmethod
    def of(cls, view: TrainingView, confirmed: DepthImage) -> Self:
        """Evidence of a view and its confirmed depths `[H, W]`, 0 elsewhere.

        Pixels that do not train accept any colour.
        """
        lowest, highest = lowest_and_highest(view.image.numpy(), COLOR_WINDOW)
        if view.trained is not None:
            unknown = ~view.trained.numpy()
            lowest[unknown], highest[unknown] = -np.inf, np.inf
        return cls(view.camera, confirmed, lowest, highest)

    def votes(
        self, points: Floats, colors: Colors, photographed_by: Camera
    ) -> tuple[Mask, Mask, Mask]:
        """Points `[..., 3]` that the view sees past, shows in another colour, or confirms.

        Colours count only where the view has no depth, and where it looks from nearly the same side: from
        another side the object itself may hide the point.

        Args:
            colors: colours of the points, `[..., 3]`.
            photographed_by: camera that saw these colours.
        """
        u, v, z = project(self.camera, points)
        within, row, column = pixel_of(self.depth.shape, u, v)
        seen = self.depth[row, column]
        beyond = np.maximum(self.lowest[row, column] - colors, colors - self.highest[row, column])
        past = within & (seen > (1 + FREE_SPACE) * z)
        comparable = within & (seen == 0) & _from_one_side(points, self.camera, photographed_by)
        miscolored = comparable & (beyond > COLOR_RANGE).any(axis=-1)
        confirmed = within & (np.abs(seen - z) <= FREE_SPACE * z)
        return past, miscolored, confirmed


def without_outvoted(
    views: Sequence[TrainingView], depths: Sequence[DepthImage], bounds: tuple[float, float]
) -> list[DepthImage]:
    """Set depths `[H, W]` that more views contradict than confirm to 0.

    If no depth would remain, the photographs' colours are not comparable and all depths are kept.

    Args:
        depths: confirmed depths of each view, 0 elsewhere.
        bounds: (near, far) z-depth of the scene's content, world units.
    """
    sources = source_indices(tuple(view.camera for view in views), bounds)
    evidence = in_parallel(
        lambda index: Evidence.of(views[index], depths[index]), range(len(views))
    )

    def not_outvoted(index: int) -> DepthImage:
        view, depth = views[index], depths[index]
        points = lift(view.camera, *pixel_centers(view.camera), depth)
        balance = np.zeros(depth.shape, dtype=np.intp)
        for other in sources[index]:
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
    """Points in whose place at least one view shows another colour; see `Evidence.votes`."""
    result = np.zeros(points.shape[:-1], dtype=np.bool_)
    for view in evidence:
        result |= view.votes(points, colors, photographed_by)[1]
    return result


def _from_one_side(points: Floats, one: Camera, other: Camera) -> Mask:
    """Points `[..., 3]` at which the lines of sight of two cameras meet below `WIDEST_ANGLE`."""
    a, b = (points - camera.center.numpy() for camera in (one, other))
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    near: Mask = (a * b).sum(axis=-1) > np.cos(np.radians(WIDEST_ANGLE)) * lengths
    return near
