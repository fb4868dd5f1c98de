from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from core_rasterizer import GaussianModel, open_device
from stereogs_plugins.exporters.transforms import TransformsExporter, stereogs_register_exporters
from tests.stereogs_plugins.building import build, offered, some_gaussians
from tests.stereogs_plugins.exporters.looking import SCENE


def test_is_offered_as_transforms() -> None:
    assert offered(stereogs_register_exporters) == {"transforms": TransformsExporter}


def test_frames_project_as_the_scenes_cameras_do(tmp_path: Path) -> None:
    """By nerfstudio's convention: the camera looks along its -z, and y is up in the image."""
    model = GaussianModel(some_gaussians([0.1], [0.5]), open_device())
    file, *pictures = build(TransformsExporter).export(model.reader(), SCENE, tmp_path)
    content = json.loads(file.read_text("utf-8"))
    point = np.array([0.3, -0.2, 2.5, 1])
    for frame, view in zip(content["frames"], (*SCENE.train, *SCENE.test), strict=True):
        x, y, z, _ = np.linalg.solve(np.array(frame["transform_matrix"]), point)
        u, v, depth = view.camera.project(torch.from_numpy(point[:3]))
        assert abs(frame["fl_x"] * x / -z + frame["cx"] - float(u)) < 1e-9
        assert abs(frame["fl_y"] * -y / -z + frame["cy"] - float(v)) < 1e-9
        assert abs(-z - float(depth)) < 1e-9
        assert (frame["w"], frame["h"]) == (view.camera.width, view.camera.height)
        assert file.parent / frame["file_path"] in pictures
        assert (file.parent / frame["file_path"]).is_file()
    assert content["train_filenames"] == [f"images/{view.name}.png" for view in SCENE.train]
    assert content["test_filenames"] == [f"images/{view.name}.png" for view in SCENE.test]
