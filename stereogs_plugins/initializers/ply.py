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
    """A point cloud with colours, or a Gaussian scene, in the scene's own coordinates."""


class PlyInitializer(Initializer[PlySettings]):
    """The points of a PLY file; of a Gaussian scene, its centres and constant colours.

    Nothing checks where the points come from: a cloud made from all photographs knows the test views.
    """

    ablation_baseline = "sfm"

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return the file's points.

        Raises:
            PlyError: the file cannot be read, or has no colours.
            SceneError: it holds no point.
        """
        from core_rasterizer import load_points

        path = self.settings.path.expanduser()
        positions, colors = load_points(path)
        if not len(positions):
            raise SceneError(
                "the PLY file holds no points",
                where=str(path),
                fix="make it again, or use the initializer `sfm` or `random`",
            )
        return PointCloud(positions, colors)


@hookimpl
def stereogs_register_initializers(register: Register[PlyInitializer]) -> None:
    register("ply", PlyInitializer)
