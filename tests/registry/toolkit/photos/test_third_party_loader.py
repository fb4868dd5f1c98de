"""The example loader for plugin authors is short and works."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from registry import Scene, SceneError, SceneLoader
from tests.stereogs_plugins.building import build

EXAMPLES = Path(__file__).parents[4] / "docs" / "examples"
SOURCE = (EXAMPLES / "stereogs-turntable-scene" / "stereogs_turntable_scene.py").read_text("utf-8")
WIDTH, HEIGHT, COUNT = 80, 60, 9


@pytest.fixture(scope="module")
def loader() -> type[SceneLoader[Any]]:
    scope: dict[str, Any] = {"__name__": "turntable"}
    exec(compile(SOURCE, "turntable", "exec", dont_inherit=True), scope)
    found: type[SceneLoader[Any]] = scope["TurntableScene"]
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Nine photographs from a circle around the origin."""
    generator = np.random.default_rng(0)
    shots = []
    for index in range(COUNT):
        pixels = generator.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
        angle = 0.2 * index
        pose = np.eye(4)
        pose[:3, 0] = np.cos(angle), 0, -np.sin(angle)
        pose[:3, 2] = np.sin(angle), 0, np.cos(angle)  # backwards
        pose[:3, 3] = 4 * pose[:3, 2]
        shots.append({"file": f"{index}.png", "camera_to_world": pose.tolist()})
    table = {"focal": 90.0, "size": [WIDTH, HEIGHT], "distortion": [-0.1, 0, 0, 0], "shots": shots}
    (tmp_path / "turntable.json").write_text(json.dumps(table))
    return tmp_path


def test_it_is_short_and_imports_public_names_only() -> None:
    lines = [line for line in SOURCE.splitlines() if line.strip()]
    assert len(lines) < 80
    imported = {
        alias.name if isinstance(node, ast.Import) else f"{node.module}.{alias.name}"
        for node in ast.walk(ast.parse(SOURCE))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert {name for name in imported if name.startswith(("registry", "stereogs"))} == {
        "stereogs.api",
        "registry.toolkit.photos",
    }


def test_its_folder_is_recognized(loader: type[SceneLoader[Any]], folder: Path) -> None:
    assert loader.recognizes(folder)


def test_its_scene_is_undistorted_resized_and_split(
    loader: type[SceneLoader[Any]], folder: Path
) -> None:
    scene: Scene = build(loader, path=folder, train_views=4, max_size=40).load()
    assert [view.name for view in scene.test] == ["0", "8"]
    assert [view.name for view in scene.train] == ["1", "3", "5", "7"]
    near, far = scene.bounds
    assert near < 4 < far
    assert np.allclose(scene.train[0].camera.center, 4 * np.array([np.sin(0.2), 0, np.cos(0.2)]))
    assert "resized from 80x60 to 40x30" in str(scene.fact("changed"))
    assert "undistorted" in str(scene.fact("changed"))


def test_missing_files_and_fields_are_explained(
    loader: type[SceneLoader[Any]], folder: Path
) -> None:
    (folder / "3.png").unlink()
    with pytest.raises(SceneError, match="a photograph is missing"):
        build(loader, path=folder, train_views=None).load()
    (folder / "turntable.json").write_text('{"focal": "long"}')
    with pytest.raises(SceneError, match="the field 'focal' cannot be used"):
        build(loader, path=folder).load()
