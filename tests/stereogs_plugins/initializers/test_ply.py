from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from core_rasterizer import Gaussians, PlyError, save_ply
from registry import Scene, SceneError
from stereogs_plugins.initializers.ply import PlyInitializer, stereogs_register_initializers
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.host import TrainingSettings, initial_gaussians
from tests.stereogs_plugins.building import build, offered

POSITIONS = torch.tensor([[0.5, -1.0, 3.0], [1.5, 0.25, 2.0]])
COLORS = torch.tensor([[0.2, 0.4, 0.6], [1.0, 0.0, 0.8]])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build(ProceduralScene, width=32, height=24).load()


def cloud(path: Path, count: int = 2, colors: bool = True) -> Path:
    fields = [(name, "<f4") for name in "xyz"]
    if colors:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(count, dtype=fields)
    for axis, name in enumerate("xyz"):
        rows[name] = POSITIONS[:count, axis]
    for channel, name in enumerate(("red", "green", "blue") if colors else ()):
        rows[name] = (COLORS[:count, channel] * 255).round()
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))
    return path


def test_registers_as_ply() -> None:
    assert offered(stereogs_register_initializers) == {"ply": PlyInitializer}


def test_a_point_cloud(tmp_path: Path, scene: Scene) -> None:
    points = build(PlyInitializer, path=cloud(tmp_path / "fused.ply")).initialize(
        scene.for_training(), {}
    )
    assert torch.equal(points.positions, POSITIONS)
    torch.testing.assert_close(points.colors, COLORS, atol=1 / 255, rtol=0)


def test_a_gaussian_scene(tmp_path: Path, scene: Scene) -> None:
    scales, turned = (
        torch.tensor([[0.1, 0.2, 0.4]]).repeat(2, 1),
        torch.tensor([[0.5, 1, 0, 0]] * 2),
    )
    sh = torch.rand(2, 16, 3) / 4
    opacities = torch.tensor([0.2, 0.7])
    gaussians = Gaussians.from_points(POSITIONS, COLORS, scales, opacities, 3, turned, sh)
    save_ply(gaussians, tmp_path / "scene.ply")
    framed = scene.in_frame().for_training()
    points = build(PlyInitializer, path=tmp_path / "scene.ply").initialize(framed, {})
    expected = framed.frame.gaussians_of_file(gaussians)
    started = initial_gaussians(points, TrainingSettings())
    for name, values in vars(expected).items():
        torch.testing.assert_close(getattr(started, name), values)


def test_a_scene_of_flat_gaussians_is_a_point_cloud(tmp_path: Path, scene: Scene) -> None:
    path = tmp_path / "flat.ply"
    save_ply(Gaussians.from_points(POSITIONS, COLORS, torch.ones(2), torch.ones(2), 0), path)
    text = path.read_bytes().replace(b"scale_2", b"extra_2")
    path.write_bytes(text)
    points = build(PlyInitializer, path=path).initialize(scene.for_training(), {})
    torch.testing.assert_close(points.colors, COLORS)
    assert points.scales is None


def test_unusable_files_are_errors(tmp_path: Path, scene: Scene) -> None:
    def initialize(path: Path) -> None:
        build(PlyInitializer, path=path).initialize(scene.for_training(), {})

    with pytest.raises(PlyError, match="cannot be opened"):
        initialize(tmp_path / "absent.ply")
    with pytest.raises(PlyError, match="red, green, blue"):
        initialize(cloud(tmp_path / "grey.ply", colors=False))
    with pytest.raises(SceneError, match="no points"):
        initialize(cloud(tmp_path / "empty.ply", count=0))
    damaged = cloud(tmp_path / "damaged.ply")
    damaged.write_bytes(damaged.read_bytes()[:-7])
    with pytest.raises(PlyError, match="declares at least"):
        initialize(damaged)
