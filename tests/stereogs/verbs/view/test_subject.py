"""cameras.json next to a PLY file: valid and damaged files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from core_rasterizer import Device, load_ply, save_ply
from registry.testing import tiny_scene
from stereogs.verbs.view.subject import of_file
from tests.stereogs.verbs.view.test_start_pose import model

SCENE = tiny_scene()


@pytest.fixture
def ply(device: Device, tmp_path: Path) -> Path:
    save_ply(model(device, 3.0).gaussians(), tmp_path / "scene.ply")
    return tmp_path / "scene.ply"


def listed() -> list[dict[str, object]]:
    """The training cameras as the 3DGS code lists them (camera_to_JSON in its camera_utils.py)."""
    return [
        {
            "id": index,
            "img_name": view.name,
            "width": view.camera.width,
            "height": view.camera.height,
            "position": view.camera.center.tolist(),
            "rotation": view.camera.world_to_camera[:3, :3].T.tolist(),
            "fx": view.camera.fx,
            "fy": view.camera.fy,
        }
        for index, view in enumerate(SCENE.train)
    ]


def test_cameras_next_to_a_file_are_shown(ply: Path, device: Device) -> None:
    ply.with_name("cameras.json").write_text(json.dumps(listed()))
    subject = of_file(ply, device)
    viewpoints = subject.viewpoints
    assert [one.name for one in viewpoints] == [view.name for view in SCENE.train]
    for one, view in zip(viewpoints, SCENE.train, strict=True):
        assert one.photograph is None
        assert (one.camera.fx, one.camera.width) == (view.camera.fx, view.camera.width)
        # The subject has a frame of its own; its cameras see the file's Gaussians at the same pixels.
        shown = one.camera.project(subject.model.read("means"))
        expected = view.camera.project(load_ply(ply).means)
        np.testing.assert_allclose(shown[0], expected[0], atol=1e-3)
        np.testing.assert_allclose(shown[1], expected[1], atol=1e-3)


def test_a_file_alone_has_no_cameras(ply: Path, device: Device) -> None:
    assert of_file(ply, device).viewpoints == ()


@pytest.mark.parametrize(
    "damage",
    [
        {"rotation": [[0, 0, 0]] * 3},
        {"fx": -1.0},
        {"width": 0},
        {"position": [1.0, 2.0]},
        {"fy": "wide"},
    ],
)
def test_an_invalid_camera_list_is_skipped_with_a_warning(
    ply: Path, device: Device, damage: dict[str, object], caplog: pytest.LogCaptureFixture
) -> None:
    cameras = listed()
    cameras[0] |= damage
    ply.with_name("cameras.json").write_text(json.dumps(cameras))
    assert of_file(ply, device).viewpoints == ()
    assert "the cameras are not shown" in caplog.text
    assert "cameras.json" in caplog.text
