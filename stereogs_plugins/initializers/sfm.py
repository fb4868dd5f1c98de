"""`sfm`: sparse points by structure from motion with known poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

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
    from collections.abc import Mapping


class SfmSettings(Settings):
    source: Literal["auto", "scene", "triangulate"] = "auto"
    """Source of the points: the scene's points, triangulation from the training photographs, or `auto`: the
    former if the scene has any."""
    max_reprojection_error: float = Field(2.0, gt=0)
    """Largest reprojection error of a point, and largest distance of a match from its epipolar line, in
    pixels."""
    min_triangulation_angle: float = Field(1.5, gt=0, lt=90)
    """Smallest angle between the rays of a point, degrees."""


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
            from registry.toolkit.views.triangulation import triangulated_points

            return triangulated_points(
                scene,
                max_reprojection_error=self.settings.max_reprojection_error,
                min_angle=self.settings.min_triangulation_angle,
                seed=self.context.seed,
            )
        if scene.points is None or not has_points:
            raise SceneError(
                "the scene has no points that its training views see",
                where=scene.name,
                fix="use `source: triangulate`, or the initializer `random`",
            )
        return scene.points


@hookimpl
def stereogs_register_initializers(register: Register[SfmInitializer]) -> None:
    register("sfm", SfmInitializer)
