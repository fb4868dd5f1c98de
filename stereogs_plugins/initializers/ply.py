"""`ply`: points from a file, for example the fused cloud of a multi-view stereo program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

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


class PlySettings(Settings):
    path: Path
    """Path of a point cloud with colours, or of a Gaussian scene, in the scene's coordinates."""


class PlyInitializer(Initializer[PlySettings]):
    """Points of a PLY file, or the Gaussians of a scene with their shapes, opacities and colours.

    The origin of the points is not checked: a cloud made from all photographs contains the test views.
    """

    ablation_baseline = "sfm"

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return the file's points.

        Raises:
            PlyError: the file cannot be read, or has no colours.
            SceneError: it contains no points.
        """
        from core_rasterizer import holds_gaussians, load_ply, load_points

        path = self.settings.path.expanduser()
        if holds_gaussians(path):
            points = PointCloud.of_gaussians(scene.frame.gaussians_of_file(load_ply(path)))
            return _or_refuse(points, path)
        positions, colors = load_points(path)
        return _or_refuse(PointCloud(scene.frame.points_of_file(positions), colors), path)


def _or_refuse(points: PointCloud, path: Path) -> PointCloud:
    if not len(points):
        raise SceneError(
            "the PLY file contains no points",
            where=str(path),
            fix="create it again, or use the initializer `sfm` or `random`",
        )
    return points


@hookimpl
def stereogs_register_initializers(register: Register[PlyInitializer]) -> None:
    register("ply", PlyInitializer)
