"""`flat`: points on a plane in front of each training camera, coloured like its photograph.

A lower bound for ablations: an initializer that estimates depth must beat it.
"""

from collections.abc import Mapping
from typing import Any

import torch
from pydantic import Field
from torch import Tensor

from stereogs import api

STEREOGS_API = 1
"""Version of the plugin API that this module was written for."""


class FlatSettings(api.Settings):
    points_per_view: int = Field(2000, ge=1)
    """Number of points per training view, at random pixels."""
    depth: float = Field(0.5, ge=0, le=1)
    """Position of the plane: 0 is the scene's near bound, 1 its far bound, linear in 1 / z."""


class FlatInitializer(api.Initializer[FlatSettings]):
    """Points at one depth, a lower bound for ablations."""

    def initialize(
        self, scene: api.TrainingScene, priors: Mapping[str, api.Prior[Any]]
    ) -> api.PointCloud:
        """Return `points_per_view` points for each training view."""
        near, far = scene.bounds
        z = 1 / ((1 - self.settings.depth) / near + self.settings.depth / far)
        parts = [self._points(view, z) for view in scene.train]
        positions, colors = (torch.cat(column) for column in zip(*parts, strict=True))
        return api.PointCloud(positions, colors)

    def _points(self, view: api.View, z: float) -> tuple[Tensor, Tensor]:
        """Return positions `[P, 3]` in world units and colours `[P, 3]` of random pixels at depth z."""
        camera, count = view.camera, self.settings.points_per_view
        # `self.generator` belongs to this component: other components do not affect its numbers.
        rows = torch.randint(camera.height, (count,), generator=self.generator)
        columns = torch.randint(camera.width, (count,), generator=self.generator)
        x = (columns + 0.5 - camera.cx) / camera.fx * z
        y = (rows + 0.5 - camera.cy) / camera.fy * z
        in_camera = torch.stack([x, y, torch.full_like(x, z)], dim=1).double()
        pose = camera.camera_to_world
        positions = in_camera @ pose[:3, :3].T + pose[:3, 3]
        return positions.float(), view.image[rows, columns]


@api.hookimpl
def stereogs_register_initializers(
    register: api.Register[FlatInitializer],
) -> None:
    register("flat", FlatInitializer)
