from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from registry import PointCloud, Scene, SceneError, View
from stereogs_plugins.initializers.sfm import SfmInitializer, stereogs_register_initializers
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.initializers.depth_scenes import distance_to_surface, pixels_of


@pytest.fixture(scope="module")
def scene(procedural_room: Scene) -> Scene:
    return replace(procedural_room, test=())


@pytest.fixture(scope="module")
def points(scene: Scene) -> PointCloud:
    return build(SfmInitializer, source="triangulate").initialize(scene.for_training(), {})


def test_registers_as_sfm() -> None:
    assert offered(stereogs_register_initializers) == {"sfm": SfmInitializer}


def test_triangulated_points_lie_on_the_true_surfaces(scene: Scene, points: PointCloud) -> None:
    assert len(points) > 300
    distances = distance_to_surface(scene, points)
    assert distances.median() < 0.003
    assert distances.quantile(0.9) < 0.02


def test_colors_are_those_of_the_photographs(scene: Scene, points: PointCloud) -> None:
    differences = []
    for view in scene.train:
        x, y, _ = pixels_of(points, view.camera)
        differences.append((view.image[y, x] - points.colors).abs().mean(dim=1))
    assert torch.stack(differences).amin(dim=0).median() < 0.05


def test_one_seed_one_result(scene: Scene, points: PointCloud) -> None:
    again = build(SfmInitializer, source="triangulate").initialize(scene.for_training(), {})
    assert torch.equal(again.positions, points.positions)
    assert torch.equal(again.colors, points.colors)


def test_off_center_principal_points_are_respected(scene: Scene, points: PointCloud) -> None:
    def crop(view: View) -> View:
        camera = replace(view.camera, cx=view.camera.cx - 40, width=view.camera.width - 40)
        return replace(view, camera=camera, image=view.image[:, 40:].contiguous(), depth=None)

    cropped = replace(scene, train=tuple(crop(view) for view in scene.train))
    found = build(SfmInitializer, source="triangulate").initialize(cropped.for_training(), {})
    distance = torch.cdist(found.positions, points.positions).amin(dim=1)
    assert distance.median() < 1e-3


def test_source_chooses(scene: Scene, points: PointCloud) -> None:
    bare = replace(scene, points=None)
    assert build(SfmInitializer).initialize(scene.for_training(), {}) is scene.points
    assert (
        build(SfmInitializer, source="scene").initialize(scene.for_training(), {}) is scene.points
    )
    assert torch.equal(
        build(SfmInitializer).initialize(bare.for_training(), {}).positions, points.positions
    )
    with pytest.raises(SceneError, match="has no points that its training views see") as caught:
        build(SfmInitializer, source="scene").initialize(bare.for_training(), {})
    assert "triangulate" in caught.value.fix


def test_points_of_one_color_get_the_colors_of_the_photographs(
    scene: Scene, points: PointCloud, caplog: pytest.LogCaptureFixture
) -> None:
    outside = torch.full((1, 3), 1e4)
    positions = torch.cat([points.positions, outside])
    black = PointCloud(positions, torch.zeros_like(positions))
    found = build(SfmInitializer).initialize(replace(scene, points=black).for_training(), {})
    assert "all points have the same colour" in caplog.text
    assert torch.equal(found.positions, positions)
    assert (found.colors[:-1] - points.colors).abs().mean(dim=1).median() < 0.1
    assert found.colors[-1].tolist() == [0.5, 0.5, 0.5]


def test_zero_points_are_explained(scene: Scene) -> None:
    grey = tuple(replace(view, image=torch.full_like(view.image, 0.5)) for view in scene.train)
    with pytest.raises(SceneError, match="no point could be triangulated") as caught:
        build(SfmInitializer, source="triangulate").initialize(
            replace(scene, train=grey).for_training(), {}
        )
    assert "random" in caught.value.fix


def test_one_view_is_explained(scene: Scene) -> None:
    alone = replace(scene, train=scene.train[:1], points=None)
    with pytest.raises(SceneError, match="one training view"):
        build(SfmInitializer).initialize(alone.for_training(), {})


def test_points_outside_the_bounds_are_dropped(scene: Scene, points: PointCloud) -> None:
    near_only = replace(scene, bounds=(scene.bounds[0], 3.0))
    found = build(SfmInitializer, source="triangulate").initialize(near_only.for_training(), {})
    assert 0 < len(found) < len(points)
    pose = scene.train[0].camera.world_to_camera
    assert (found.positions.double() @ pose[2, :3] + pose[2, 3]).median() < 3.3
