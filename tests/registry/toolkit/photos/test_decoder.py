"""Decoding: pixel modes, sizes, filters, and the disk cache."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import Decoder, at_most, divided_by


@pytest.mark.parametrize(
    ("mode", "color"), [("L", 100), ("RGB", (100, 100, 100)), ("P", 100), ("LA", (100, 255))]
)
def test_other_pixel_modes_become_rgb(
    mode: str, color: int | tuple[int, ...], tmp_path: Path
) -> None:
    image = Image.new(mode, (4, 3), color)
    if mode == "P":
        image.putpalette([value for value in range(256) for _ in range(3)])
    image.save(tmp_path / "a.png")
    pixels = Decoder().read(tmp_path / "a.png")
    assert pixels.shape == (3, 4, 3)
    assert (pixels == 100).all()


def test_sixteen_bits_are_refused_not_clipped(tmp_path: Path) -> None:
    Image.fromarray(np.full((3, 4), 40000, dtype=np.uint16)).save(tmp_path / "a.png")
    with pytest.raises(SceneError, match="not 8 bits per channel"):
        Decoder().read(tmp_path / "a.png")


def test_sizes() -> None:
    assert divided_by(8)(4946, 3286) == (618, 411)
    assert divided_by(100)(8, 6) == (1, 1)
    assert at_most(400)(1600, 1200) == (400, 300)
    assert at_most(400)(399, 100) == (399, 100)


def test_the_filter_is_the_configured_one(tmp_path: Path) -> None:
    columns = np.zeros((4, 8, 3), dtype=np.uint8)
    columns[:, ::2] = 200
    Image.fromarray(columns).save(tmp_path / "a.png")
    pixels = Decoder(size=divided_by(2), resize_filter="box").read(tmp_path / "a.png")
    assert (pixels == 100).all()
    other = Decoder(size=divided_by(2), resize_filter="bicubic").read(tmp_path / "a.png")
    assert (other != 100).any()


def test_resized_photographs_are_cached_by_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    photograph = tmp_path / "a.png"
    noise = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    Image.fromarray(noise).save(photograph)
    half = Decoder(size=divided_by(2))
    fresh = half.read(photograph)
    (kept,) = (tmp_path / "cache" / "photographs").glob("*/image.png")
    with monkeypatch.context() as patch:  # it is read, not computed
        patch.delattr(Image.Image, "resize")
        np.testing.assert_array_equal(half.read(photograph), fresh)
    kept.write_bytes(b"damaged")
    np.testing.assert_array_equal(half.read(photograph), fresh)
    assert "damaged" in caplog.text
    Decoder(size=divided_by(2), resize_filter="box").read(photograph)
    Image.fromarray(255 - noise).save(photograph)
    assert (half.read(photograph) != fresh).any()
    assert len(list((tmp_path / "cache" / "photographs").iterdir())) == 3


def test_a_cache_that_cannot_be_written_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "cache").write_text("a file, not a folder")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    assert Decoder(size=divided_by(2)).read(tmp_path / "a.png").shape == (4, 4, 3)
    assert "could not be cached" in caplog.text
