"""What is said of a scene before training: facts, and warnings of what usually fails."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from core_rasterizer import Camera
from registry import PointCloud, Scene, View
from registry.testing import tiny_scene
from registry.training.scene_facts import points_in_view, summary, typical_depth, warnings


def camera(x: float = 0.0, degrees: float = 0.0) -> Camera:
    """At `(x, 0, 0)`, turned to the right of +z."""
    angle = np.radians(degrees)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.tensor(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, 0.0, 0.0], dtype=torch.float64)
    return Camera(pose, 40, 40, 16, 12, 32, 24)


def scene_of(*cameras: Camera, points: PointCloud | None = None) -> Scene:
    views = [View(f"v{k}", c, torch.full((24, 32, 3), 0.5)) for k, c in enumerate(cameras)]
    return Scene("made", tuple(views), (), (1.0, 4.0), points=points)


def wall(count: int, depth: float = 2.0) -> PointCloud:
    """Points close to the optical axis of a camera at the origin."""
    positions = torch.zeros(count, 3)
    positions[:, 0] = torch.linspace(-0.1, 0.1, count)
    positions[:, 2] = depth
    return PointCloud(positions, torch.full((count, 3), 0.5))


def test_the_summary_line_before_training() -> None:
    assert summary(tiny_scene()) == (
        "tiny: 2 training views, 1 test view, 32x24, depth 1.5 .. 5, 60 points"
    )


def test_a_good_scene_has_no_warning() -> None:
    assert warnings(scene_of(camera(-0.2), camera(0.2), points=wall(200))) == []


def test_points_outside_and_behind_are_not_counted() -> None:
    points = PointCloud(
        torch.tensor([[0.0, 0, 2], [0, 0, -2], [5, 0, 2], [0.7, 0.5, 2]]), torch.zeros(4, 3)
    )
    scene = scene_of(camera(), points=points)
    assert points_in_view(scene, scene.train[0]) == 2
    assert typical_depth(scene) == 2


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        (scene_of(camera(-0.2), camera(0.2)), []),
        (scene_of(camera(-0.2), camera(0.2), points=wall(50)), ["only 50 sparse points"]),
        (
            scene_of(camera(-0.2), camera(0.2, 60), points=wall(200)),
            ["v1 has only 0", "v0 looks 60 degrees", "v1 looks 60 degrees"],
        ),
        (
            scene_of(camera(0.0), camera(0.01), camera(1.0), points=wall(200, depth=8.0)),
            ["v0 and v1 were taken from nearly one place: 0.12%"],
        ),
        (
            scene_of(*(camera(0.001 * k * k) for k in range(5)), points=wall(200)),
            ["v0 and v1 were", "v1 and v2 were", "v0 and v2 were", "7 more warnings like"],
        ),
        (scene_of(camera(3.0), camera(3.0 + 1e-9, 5)), ["equal to 8 digits"]),
        (scene_of(camera(5e6), camera(5e6 + 0.4, 5)), []),
        (scene_of(camera(), points=wall(200)), ["a single training view"]),
    ],
    ids=[
        *(
            "no points",
            "few points",
            "wide apart",
            "one place",
            "many",
            "rounding",
            "survey coordinates",
        ),
        "one view",
    ],
)
def test_warnings(scene: Scene, expected: list[str]) -> None:
    found = warnings(scene)
    assert len(found) == len(expected)
    for text, part in zip(found, expected, strict=True):
        assert part in text
