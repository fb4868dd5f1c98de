"""`sfm`: sparse points by structure from motion with known poses."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from registry import (
    Initializer,
    PointCloud,
    Prior,
    Register,
    SceneError,
    Settings,
    TrainingScene,
    hookimpl,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from registry import TrainingView

_log = logging.getLogger("stereogs.sfm")

MIN_TRIANGULATION_ANGLE = 1.5
"""Smallest angle between the rays of a point, degrees."""


class SfmSettings(Settings):
    removed: ClassVar = {"min_triangulation_angle": MIN_TRIANGULATION_ANGLE}
    source: Literal["auto", "scene", "triangulate"] = "auto"
    """Source of the points: the scene's points, triangulation from the training photographs, or `auto`: the
    former if the scene has any."""
    max_reprojection_error: float = Field(2.0, gt=0)
    """Largest reprojection error of a point, and largest distance of a match from its epipolar line, in
    pixels."""


class SfmInitializer(Initializer[SfmSettings]):
    """The scene's points, or points triangulated from the training views at the known poses."""

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point.

        Raises:
            SceneError: the scene has no points, or no match between training views fits the poses.
        """
        source = self.settings.source
        has_points = scene.points is not None and len(scene.points) > 0
        if source == "auto":
            source = "scene" if has_points else "triangulate"
        if source == "triangulate":
            from registry.toolkit.views import triangulated_points

            return triangulated_points(
                scene,
                max_reprojection_error=self.settings.max_reprojection_error,
                min_angle=MIN_TRIANGULATION_ANGLE,
                seed=self.context.seed,
            )
        if scene.points is None or not has_points:
            raise SceneError(
                "the scene has no points that its training views see",
                where=scene.name,
                fix="use `source: triangulate`, or the initializer `random`",
            )
        points = scene.points
        one_color = len(points) > 1 and bool((points.colors == points.colors[0]).all())
        if one_color and points.sh is None:
            _log.warning("all points have the same colour; colours of the photographs are used")
            return replace(points, colors=mean_colors(points.positions, scene.train))
        return points


def mean_colors(positions: Tensor, views: Sequence[TrainingView]) -> Tensor:
    """Colours of points `[P, 3]` in [0, 1]: the mean over the views that contain them, occluded or not.

    Grey where no view contains the point. Black points would stay black: a colour that is clamped at zero
    has no gradient.
    """
    import torch

    total, count = torch.zeros(len(positions), 3), torch.zeros(len(positions), 1)
    for view in views:
        u, v, z = view.camera.project(positions)
        inside = view.camera.contains(u, v, z)
        total[inside] += view.image[v[inside].long(), u[inside].long()]
        count[inside] += 1
    return torch.where(count > 0, total / count.clamp(min=1), torch.tensor(0.5))


@hookimpl
def stereogs_register_initializers(register: Register[SfmInitializer]) -> None:
    register("sfm", SfmInitializer)
