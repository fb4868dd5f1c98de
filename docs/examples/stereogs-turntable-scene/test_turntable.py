"""Tests by the author of a plugin: the contract, and the purpose of the component."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from stereogs_turntable_scene import TurntableScene, TurntableSettings

from core_rasterizer import open_device
from stereogs import api
from stereogs.testing import check


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five photographs from a circle around the origin."""
    generator, shots = np.random.default_rng(0), []
    for index in range(5):
        pixels = generator.integers(0, 255, (30, 40, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
        angle, pose = 0.2 * index, np.eye(4)
        pose[:3, 0] = np.cos(angle), 0, -np.sin(angle)
        pose[:3, 2] = np.sin(angle), 0, np.cos(angle)  # backwards
        pose[:3, 3] = 4 * pose[:3, 2]
        shots.append({"file": f"{index}.png", "camera_to_world": pose.tolist()})
    table = {"focal": 45.0, "size": [40, 30], "distortion": [0, 0, 0, 0], "shots": shots}
    (tmp_path / "turntable.json").write_text(json.dumps(table))
    return tmp_path


def test_it_keeps_the_contract(folder: Path) -> None:
    check(TurntableScene, path=folder, test_every=2, train_views=2)


def test_cameras_look_at_the_middle_of_the_table(folder: Path) -> None:
    settings = TurntableSettings(path=folder, test_every=2, train_views=2)
    scene = TurntableScene(settings, api.Context("t", 0, open_device())).load()
    for view in (*scene.train, *scene.test):
        center = view.camera.world_to_camera[:3, 3]
        np.testing.assert_allclose(center, [0, 0, 4], atol=1e-9)
