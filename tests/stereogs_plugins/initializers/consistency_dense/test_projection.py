from __future__ import annotations

import numpy as np

from core_rasterizer import Camera
from registry import Scene
from stereogs_plugins.initializers.consistency_dense.projection import (
    interpolate,
    lift,
    look_up,
    pixel_centers,
    project,
)
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.initializers.depth_scenes import camera_at


def test_lift_and_project_undo_each_other() -> None:
    scene: Scene = build(ProceduralScene, width=32, height=24, points=0).load()
    camera = scene.train[0].camera
    u, v = pixel_centers(camera)
    depth = np.random.default_rng(0).uniform(1, 9, u.shape)
    again_u, again_v, again_z = project(camera, lift(camera, u, v, depth))
    np.testing.assert_allclose(again_u, u, atol=1e-9)
    np.testing.assert_allclose(again_v, v, atol=1e-9)
    np.testing.assert_allclose(again_z, depth, atol=1e-9)


def test_a_known_point() -> None:
    camera = camera_at(1.0, cx=12.5, cy=7.0)
    point = lift(camera, np.array([22.5]), np.array([2.0]), np.array([4.0]))
    np.testing.assert_allclose(point, [[1.0 + 10 / 50 * 4, -5 / 50 * 4, 4.0]])


def test_points_behind_the_camera_have_no_pixel() -> None:
    u, v, z = project(camera_at(0.0), np.array([[0.0, 0.0, -2.0], [1.0, 1.0, 0.0]]))
    assert np.isinf(u).all()
    assert np.isinf(v).all()
    assert (z <= 0).all()
    assert (look_up(np.ones((4, 4), dtype=np.float32), u, v) == 0).all()


def plane(camera: Camera) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Depth of a slanted plane: its inverse is linear in the image."""
    u, v = pixel_centers(camera)
    return (1 / (0.1 + 0.002 * u - 0.001 * v)).astype(np.float32)


def test_interpolation_is_exact_on_a_plane() -> None:
    depth = plane(camera_at(0.0))
    u, v = np.array([10.0, 33.3, 59.2]), np.array([20.5, 7.9, 39.2])
    np.testing.assert_allclose(interpolate(depth, u, v), 1 / (0.1 + 0.002 * u - 0.001 * v), 1e-6)


def test_interpolation_skips_unknown_pixels() -> None:
    depth = np.full((4, 6), 3.0, dtype=np.float32)
    depth[:, 3:] = 0
    u, v = np.array([2.9, 3.1, 4.6, -0.1, 2.0]), np.array([2.0, 2.0, 2.0, 2.0, 4.1])
    np.testing.assert_allclose(interpolate(depth, u, v), [3.0, 3.0, 0.0, 0.0, 0.0])
