from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import Rendering
from registry import RunError
from registry.testing import tiny_scene
from registry.toolkit.drawing.camera_path import smooth_path
from registry.toolkit.drawing.pictures import (
    depth_picture,
    nearness_picture,
    save_png,
    save_view_pictures,
    side_by_side,
)
from registry.toolkit.drawing.video import write_video


def test_png_is_rounded_and_clamped(tmp_path: Path) -> None:
    image = torch.tensor([[[-1.0, 0.5, 2.0], [0.1, 0.2, 0.3]]])
    save_png(image, tmp_path / "a.png")
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    assert pixels.tolist() == [[[0, 128, 255], [26, 51, 76]]]


def test_near_is_lighter_than_far_and_empty_is_black() -> None:
    alpha = torch.tensor([[1.0, 0.8, 0.9, 0.1]])
    depth = alpha * torch.tensor([[1.0, 2.0, 4.0, 3.0]])
    picture = depth_picture(Rendering(torch.zeros(1, 4, 3), depth, alpha))
    light = picture.mean(dim=2)[0].tolist()
    assert light[0] > light[1] > light[2] > light[3] == 0


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_constant_depth_is_drawn(alpha: float) -> None:
    maps = torch.full((3, 5), alpha)
    picture = depth_picture(Rendering(torch.zeros(3, 5, 3), maps, maps))
    assert picture.shape == (3, 5, 3)
    assert torch.isfinite(picture).all()


def test_unknown_nearness_does_not_affect_colors() -> None:
    nearness = torch.tensor([[1.0, 2.0, 3.0, torch.nan], [4.0, 5.0, torch.inf, -1e9]])
    known = torch.isfinite(nearness) & (nearness > 0)
    picture = nearness_picture(nearness, known)
    assert (picture[~known] == 0).all()
    assert (picture[known].sum(dim=1).diff() > 0).all()
    assert torch.equal(picture, nearness_picture(nearness.where(known, 7.0), known))
    assert not nearness_picture(nearness, torch.zeros_like(known)).any()


def test_no_two_views_share_a_file(tmp_path: Path) -> None:
    names = ["a", "a_depth", "a_comparison", "a.png", "depth", "comparison"]
    view = tiny_scene().test[0]
    maps = torch.ones(view.image.shape[:2])
    rendering = Rendering(view.image, maps, maps)
    files = [save_view_pictures(rendering, replace(view, name=name), tmp_path) for name in names]
    written = {path for f in files for path in (f.render, f.depth, f.comparison)}
    assert written == {*tmp_path.rglob("*.png")}
    assert len(written) == 3 * len(names)


def test_side_by_side() -> None:
    row = side_by_side(torch.zeros(2, 3, 3), torch.full((2, 5, 3), 0.5))
    assert row.shape == (2, 3 + 4 + 5, 3)
    assert row[0, :, 0].tolist() == [0.0] * 3 + [1.0] * 4 + [0.5] * 5


def test_the_path_visits_every_camera() -> None:
    cameras = [view.camera for view in (*tiny_scene().train, *tiny_scene().test)]
    path = smooth_path(cameras, 3 * 8)
    assert len(path) == 24
    for index, camera in enumerate(cameras):
        torch.testing.assert_close(path[8 * index].world_to_camera, camera.world_to_camera)
        assert path[8 * index].fx == pytest.approx(camera.fx)
    steps = [
        float((a.center - b.center).norm()) for a, b in zip(path, [*path[1:], path[0]], strict=True)
    ]
    assert max(steps) < 0.15


def test_a_path_needs_two_cameras() -> None:
    camera = tiny_scene().train[0].camera
    with pytest.raises(RunError, match="no path exists"):
        smooth_path([camera], 10)
    with pytest.raises(RunError, match="no path exists"):
        smooth_path([camera, camera], 1)


def test_without_an_encoder_images_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    write_video([torch.rand(5, 7, 3)] * 4, tmp_path / "path")
    written, note = write_video([torch.rand(5, 7, 3)] * 3, tmp_path / "path")
    assert sorted(file.name for file in written.iterdir()) == ["0000.png", "0001.png", "0002.png"]
    assert "pip install" in note


def test_with_an_encoder_a_video_is_written(tmp_path: Path) -> None:
    encoder = pytest.importorskip("imageio_ffmpeg")
    frames = [torch.full((33, 47, 3), shade) for shade in (0.0, 0.5, 1.0, 0.5)]
    written, note = write_video(frames, tmp_path / "path")
    assert note == "MP4 video"
    assert [file.name for file in tmp_path.iterdir()] == ["path.mp4"]
    reader = encoder.read_frames(str(written))
    assert next(reader)["size"] == (48, 34)
    assert len(list(reader)) == 4
