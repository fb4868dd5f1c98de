from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import GaussianModel, open_device
from registry.toolkit import photos
from stereogs_plugins.exporters.colmap import ColmapExporter, stereogs_register_exporters
from tests.stereogs_plugins.building import build, offered, some_gaussians
from tests.stereogs_plugins.exporters.looking import SCENE

VIEWS = (*SCENE.train, *SCENE.test)


def exported(folder: Path, *, text: bool = False) -> list[Path]:
    model = GaussianModel(some_gaussians([0.1], [0.5]), open_device())
    return build(ColmapExporter, text=text).export(model.reader(), SCENE, folder)


def test_is_offered_as_colmap() -> None:
    assert offered(stereogs_register_exporters) == {"colmap": ColmapExporter}


@pytest.mark.parametrize("text", [False, True])
def test_pycolmap_reads_the_same_cameras_and_points(tmp_path: Path, text: bool) -> None:
    written = exported(tmp_path, text=text)
    endings = {file.suffix for file in written}
    assert endings == ({".png", ".txt"} if text else {".png", ".txt", ".bin"})
    model = photos.import_pycolmap().Reconstruction(str(tmp_path / "colmap" / "sparse" / "0"))
    assert len(model.cameras) == 1  # all views share a lens
    by_name = {image.name: image for image in model.images.values()}
    assert sorted(by_name) == sorted(f"{view.name}.png" for view in VIEWS)
    point = np.array([0.3, -0.2, 2.5])
    for view in VIEWS:
        u, v, _ = view.camera.project(torch.from_numpy(point))
        seen = by_name[f"{view.name}.png"].project_point(point)
        np.testing.assert_allclose(seen, [float(u), float(v)], atol=1e-9)
    assert SCENE.points is not None
    places = np.stack([model.points3D[key].xyz for key in sorted(model.points3D)])
    colors = np.stack([model.points3D[key].color for key in sorted(model.points3D)])
    np.testing.assert_allclose(places, SCENE.points.positions.numpy(), atol=1e-6)
    np.testing.assert_allclose(colors, SCENE.points.colors.numpy() * 255, atol=0.5001)


def test_photographs_and_the_split_lie_beside_it(tmp_path: Path) -> None:
    exported(tmp_path)
    for view in VIEWS:
        with Image.open(tmp_path / "colmap" / "images" / f"{view.name}.png") as image:
            difference = np.asarray(image) - view.image.numpy() * 255
        assert abs(difference).max() <= 0.501
    split = (tmp_path / "colmap" / "sparse" / "0" / "test.txt").read_text("utf-8")
    assert split.split() == [f"{view.name}.png" for view in SCENE.test]
