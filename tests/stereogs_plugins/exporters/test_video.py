from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from core_rasterizer import GaussianModel, open_device
from registry.toolkit.drawing import smooth_path
from stereogs_plugins.exporters.video import VideoExporter
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.exporters.looking import SCENE, colorful


def test_without_an_encoder_pictures_show_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    model = GaussianModel(colorful(), open_device())
    written = build(VideoExporter, frames=3).export(model.reader(), SCENE, tmp_path)
    assert [file.name for file in written] == ["0000.png", "0001.png", "0002.png"]
    cameras = smooth_path([view.camera for view in SCENE.train], 3)
    with Image.open(written[1]) as image:
        shown = np.asarray(image) / 255
    expected = model.reader().render(cameras[1], background=SCENE.background).rgb.numpy()
    assert abs(shown - expected).max() <= 0.501 / 255


def test_with_an_encoder_one_film_has_all_frames(tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    model = GaussianModel(colorful(), open_device())
    (film,) = build(VideoExporter, frames=5).export(model.reader(), SCENE, tmp_path)
    assert film == tmp_path / "flight.mp4"
    assert imageio_ffmpeg.count_frames_and_secs(str(film))[0] == 5
