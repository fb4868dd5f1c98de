from __future__ import annotations

import pytest
import torch

from registry import Scene
from stereogs_plugins.initializers.random import RandomInitializer, stereogs_register_initializers
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build, offered


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build(ProceduralScene, width=80, height=60).load()


def test_registers_as_random() -> None:
    assert offered(stereogs_register_initializers) == {"random": RandomInitializer}


def test_points_lie_in_a_frustum_and_have_its_colors(scene: Scene) -> None:
    points = build(RandomInitializer, count=3000).initialize(scene.for_training(), {})
    assert len(points) == 3000
    explained = torch.zeros(3000, dtype=torch.bool)
    for view in scene.train:
        camera, pose = view.camera, view.camera.world_to_camera
        local = points.positions.double() @ pose[:3, :3].T + pose[:3, 3]
        x = (local[:, 0] / local[:, 2] * camera.fx + camera.cx).long()
        y = (local[:, 1] / local[:, 2] * camera.fy + camera.cy).long()
        near, far = scene.bounds
        inside = (local[:, 2] >= near - 1e-4) & (local[:, 2] <= far + 1e-4)
        inside &= (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        color = view.image[y.clamp(0, camera.height - 1), x.clamp(0, camera.width - 1)]
        explained |= inside & (color == points.colors).all(dim=1)
    assert explained.float().mean() > 0.995  # rounding moves a few across the edge of a pixel


def test_inverse_depth_is_uniform(scene: Scene) -> None:
    single = Scene("one", scene.train[:1], (), (1.0, 10.0))
    points = build(RandomInitializer, count=20_000).initialize(single.for_training(), {})
    pose = single.train[0].camera.world_to_camera
    inverse = 1 / (points.positions.double() @ pose[2, :3] + pose[2, 3])
    shares = torch.histc(inverse.float(), bins=9, min=0.1, max=1.0) / 20_000
    torch.testing.assert_close(shares, torch.full((9,), 1 / 9), atol=0.01, rtol=0)


def test_one_seed_one_result(scene: Scene) -> None:
    first, again, other = (
        build(RandomInitializer, seed, count=50).initialize(scene.for_training(), {}).positions
        for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
