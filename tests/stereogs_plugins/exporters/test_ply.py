from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData

from core_rasterizer import GaussianModel, load_ply, open_device
from stereogs_plugins.exporters.ply import (
    CamerasExporter,
    PlyExporter,
    stereogs_register_exporters,
)
from tests.stereogs_plugins.building import build, offered, some_gaussians
from tests.stereogs_plugins.exporters.looking import SCENE, colorful


def test_are_offered_by_name() -> None:
    exporters = {"ply": PlyExporter, "cameras": CamerasExporter}
    assert offered(stereogs_register_exporters) == exporters


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    gaussians = some_gaussians([0.1, 0.2, 0.3], [0.1, 0.5, 0.9])
    model = GaussianModel(gaussians, open_device())
    written = build(PlyExporter).export(model.reader(), SCENE, tmp_path)
    assert written == [tmp_path / "scene.ply", tmp_path / "cameras.json"]
    again = load_ply(written[0])
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        assert torch.equal(getattr(again, name), getattr(gaussians, name))


def test_another_reader_finds_the_standard_columns(tmp_path: Path) -> None:
    gaussians = colorful(7)
    model = GaussianModel(gaussians, open_device())
    build(PlyExporter).export(model.reader(), SCENE, tmp_path)
    vertex = PlyData.read(str(tmp_path / "scene.ply"))["vertex"]
    np.testing.assert_array_equal(vertex["rot_3"], gaussians.quaternions[:, 3].numpy())
    # All coefficients of red come first, then green's: number 15 is green's first.
    np.testing.assert_array_equal(vertex["f_rest_15"], gaussians.sh[:, 1, 1].numpy())


def test_cameras_project_as_the_scenes_do(tmp_path: Path) -> None:
    """By the formula of the 3DGS code's own reader: columns of the rotation are the camera's axes."""
    model = GaussianModel(some_gaussians([0.1], [0.5]), open_device())
    (file,) = build(CamerasExporter).export(model.reader(), SCENE, tmp_path)
    cameras = json.loads(file.read_text("utf-8"))
    views = (*SCENE.train, *SCENE.test)
    assert [camera["img_name"] for camera in cameras] == [view.name for view in views]
    assert [camera["id"] for camera in cameras] == [0, 1, 2]
    point = np.array([0.3, -0.2, 2.5])
    for listed, view in zip(cameras, views, strict=True):
        x, y, z = np.array(listed["rotation"]).T @ (point - np.array(listed["position"]))
        u, v, depth = view.camera.project(torch.from_numpy(point))
        assert abs(listed["fx"] * x / z + listed["width"] / 2 - float(u)) < 1e-9
        assert abs(listed["fy"] * y / z + listed["height"] / 2 - float(v)) < 1e-9
        assert abs(z - float(depth)) < 1e-9
