"""`procedural`: a ray-cast furnished room with exact poses and depth; needs no download.

Its textures are the photographs in the scikit-image package. Shading does not depend on the viewing
direction, so a perfect reconstruction is possible.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from registry import (
    Fact,
    PointCloud,
    Register,
    Scene,
    SceneLoader,
    Settings,
    View,
    hookimpl,
    validate,
)

if TYPE_CHECKING:
    import numpy as np

    from core_rasterizer import Camera

    from .ray_casting import Surface

FIELD_OF_VIEW = math.radians(62)
"""Horizontal field of view of every camera, radians."""
TARGET = (0.0, 0.1, 3.2)
"""Point that the cameras look at."""
ARC_RADIUS = 3.2
ARC_HALF_ANGLE = math.radians(11)
"""Training cameras are on an arc around the target, from minus to plus this angle, radians."""
HEIGHT_SWING = 0.08
"""Height of the cameras above and below eye level, alternating."""
EYE_LEVEL = -0.1


class ProceduralSettings(Settings):
    train_views: int = Field(3, ge=1, le=1000)
    """Number of training views, in front of the room."""
    row_spacing: float | None = Field(None, gt=0, allow_inf_nan=False)
    """Metres between neighbouring training cameras in a row from left to right that all look straight
    ahead, so that any two are a rectified pair. null: cameras on an arc that look inwards."""
    test_views: int = Field(4, ge=0, le=1000)
    """Number of test views, between the training views and at other heights."""
    width: int = Field(252, ge=16, le=4096)
    """Image width in pixels."""
    height: int = Field(189, ge=16, le=4096)
    """Image height in pixels."""
    points: int = Field(2000, ge=0, le=1_000_000)
    """Number of sparse points on surfaces that the training views see."""
    point_noise: float = Field(0.01, ge=0)
    """Standard deviation of the points' positions around the true surface, metres."""
    seed: int = Field(0, ge=0)
    """Seed of the furniture and the points."""


class ProceduralScene(SceneLoader[ProceduralSettings]):
    """A room with textured boxes, balls and posters, with exact poses and depths."""

    def load(self) -> Scene:
        """Return the scene, deterministic in the settings."""
        import numpy as np
        import torch

        from .room import furnish

        settings = self.settings
        generator = np.random.default_rng(settings.seed)
        surfaces = furnish(_focal(settings.width), generator)
        train = [
            self._view(f"train_{k:02d}", surfaces, self._train_camera(k))
            for k in range(settings.train_views)
        ]
        test = []
        for k in range(settings.test_views):
            angle, size = _angle(k, settings.test_views, 0.8), (settings.width, settings.height)
            camera = _camera_on_arc(angle, -_lift(k) / 2, *size)
            test.append(self._view(f"test_{k:02d}", surfaces, camera))
        depths = torch.cat([view.depth[view.depth > 0] for view in train if view.depth is not None])
        points = _sample_points(train, settings.points, settings.point_noise, generator)
        return validate(
            Scene(
                name="procedural",
                train=tuple(train),
                test=tuple(test),
                bounds=(0.95 * float(depths.min()), 1.05 * float(depths.max())),
                points=points,
                facts=(Fact("source", "ray-cast room"), Fact("seed", settings.seed)),
            )
        )

    def _train_camera(self, index: int) -> Camera:
        settings = self.settings
        size = (settings.width, settings.height)
        if settings.row_spacing is None:
            return _camera_on_arc(_angle(index, settings.train_views, 1.0), _lift(index), *size)
        place = settings.row_spacing * (index - (settings.train_views - 1) / 2)
        return _camera_in_row(place, *size)

    def _view(self, name: str, surfaces: list[Surface], camera: Camera) -> View:
        import numpy as np
        import torch

        from .ray_casting import cast

        colors, depth = cast(surfaces, camera)
        return View(
            name=name,
            camera=camera,
            image=torch.from_numpy(colors.astype(np.float32)),
            depth=torch.from_numpy(depth.astype(np.float32)),
        )


def _focal(width: int) -> float:
    return width / 2 / math.tan(FIELD_OF_VIEW / 2)


def _angle(index: int, count: int, part: float) -> float:
    """Angles evenly spread over `part` of the arc; a single camera is in the middle."""
    return 0.0 if count == 1 else part * ARC_HALF_ANGLE * (2 * index / (count - 1) - 1)


def _lift(index: int) -> float:
    return HEIGHT_SWING if index % 2 else -HEIGHT_SWING


def _camera_on_arc(angle: float, lift: float, width: int, height: int) -> Camera:
    """A level camera that looks at the target from `angle` radians to its side."""
    import numpy as np
    import torch

    from core_rasterizer import Camera

    offset = ARC_RADIUS * np.array([math.sin(angle), 0.0, -math.cos(angle)])
    target = np.array(TARGET)
    center = target + offset
    center[1] = EYE_LEVEL + lift
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    focal = _focal(width)
    return Camera(torch.from_numpy(pose), focal, focal, width / 2, height / 2, width, height)


def _camera_in_row(place: float, width: int, height: int) -> Camera:
    """A camera at eye level, `place` metres right of the middle, that looks straight ahead."""
    import torch

    from core_rasterizer import Camera

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([-place, -EYE_LEVEL, 0.0])
    return Camera.centered(pose, _focal(width), width, height)


def _sample_points(
    views: list[View], count: int, noise: float, generator: np.random.Generator
) -> PointCloud | None:
    """Points at the true depth of random pixels of the views, plus noise, with the pixels' colours."""
    import numpy as np
    import torch

    if not count:
        return None
    positions, colors = [], []
    for view, share in zip(views, _shares(count, len(views)), strict=True):
        assert view.depth is not None
        pixels = torch.from_numpy(generator.choice(np.flatnonzero(view.depth > 0), size=share))
        u, v = (axis.ravel()[pixels] for axis in view.camera.pixel_centers())
        positions.append(view.camera.unproject(u, v, view.depth.ravel()[pixels]))
        colors.append(view.image.reshape(-1, 3)[pixels])
    exact = torch.cat(positions).numpy()
    moved = exact + noise * generator.standard_normal(exact.shape)
    return PointCloud(
        positions=torch.from_numpy(moved.astype(np.float32)),
        colors=torch.cat(colors),
    )


def _shares(count: int, parts: int) -> list[int]:
    return [count // parts + (k < count % parts) for k in range(parts)]


@hookimpl
def stereogs_register_scenes(register: Register[ProceduralScene]) -> None:
    register("procedural", ProceduralScene)
