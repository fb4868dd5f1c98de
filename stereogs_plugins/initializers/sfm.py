"""`sfm`: sparse points that the training photographs agree on (structure from motion, poses known)."""

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
    """Where points come from: the scene's own, the training photographs, or whichever is there first."""
    max_reprojection_error: float = Field(2.0, gt=0)
    """Pixels; a point that misses its features by more is dropped, and so is a match off its line."""
    min_triangulation_angle: float = Field(1.5, gt=0, lt=90)
    """Degrees; points whose rays are more parallel than this are dropped."""


class SfmInitializer(Initializer[SfmSettings]):
    """The scene's own points, or points triangulated at the known poses from the training views."""

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point.

        Raises:
            SceneError: the scene has no points, or the training views agree on none.
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
                "the scene brings no points that its training views see",
                where=scene.name,
                fix="use `source: triangulate`, or the initializer `random`",
            )
        return scene.points


@hookimpl
def stereogs_register_initializers(register: Register[SfmInitializer]) -> None:
    register("sfm", SfmInitializer)
