"""Copies of photographs are recognized by what they show, and neighbouring photographs are not copies."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from core_rasterizer import Camera
from registry.toolkit.photos import Decoder, Impression, Lens, LoadedPhotos, PosedPhoto

SIZE = (400, 300)


def texture(seed: int) -> Image.Image:
    """A picture with details of all sizes."""
    random = np.random.default_rng(seed)
    layers = [
        Image.fromarray(random.integers(0, 256, (3 * n, 4 * n), dtype=np.uint8)).resize(
            SIZE, Image.Resampling.BICUBIC
        )
        for n in (2, 8, 32)
    ]
    mean = np.mean([np.asarray(layer) for layer in layers], axis=0)
    return Image.fromarray(mean.astype(np.uint8)).convert("RGB")


def shifted(picture: Image.Image, pixels: int) -> Image.Image:
    """The lower half moves to the side, as things near a camera that moves do."""
    moved = picture.rotate(0, Image.Resampling.BICUBIC, translate=(pixels, 0))
    both = picture.copy()
    both.paste(moved.crop((0, 150, 400, 300)), (0, 150))
    return both


def saved(picture: Image.Image, file_format: str, quality: int) -> Image.Image:
    stream = BytesIO()
    picture.save(stream, file_format, quality=quality)
    return Image.open(stream)


def alike(one: Image.Image, other: Image.Image) -> bool:
    return Impression.of(one).is_copy_of(Impression.of(other))


@pytest.mark.parametrize("quality", [50, 95])
@pytest.mark.parametrize("file_format", ["JPEG", "WEBP"])
@pytest.mark.parametrize("divisor", [1, 2, 4])
def test_other_formats_and_sizes_are_copies(file_format: str, quality: int, divisor: int) -> None:
    picture = texture(0)
    small = picture.resize((400 // divisor, 300 // divisor), Image.Resampling.BICUBIC)
    assert alike(saved(small, file_format, quality), picture)


def test_grey_blurred_and_darker_pictures_are_copies() -> None:
    picture = texture(0)
    assert alike(picture.convert("L"), picture)
    assert alike(picture.filter(ImageFilter.GaussianBlur(2)), picture)
    assert alike(picture.point(lambda value: 0.7 * value), picture)


@pytest.mark.parametrize("pixels", [1, 3, 10])
def test_neighbouring_photographs_are_not_copies(pixels: int) -> None:
    assert not alike(shifted(texture(0), pixels), texture(0))


def test_other_and_plain_pictures_are_not_copies() -> None:
    assert not alike(texture(0), texture(1))
    assert not alike(texture(0).crop((0, 0, 300, 300)), texture(0))
    assert not alike(Image.new("RGB", SIZE, "red"), Image.new("RGB", SIZE, "red"))
    assert not alike(Image.new("RGB", (1, 1)), Image.new("RGB", (3, 1)))


def test_a_sideways_photograph_is_compared_upright() -> None:
    stream, exif = BytesIO(), Image.Exif()
    exif[0x0112] = 6  # to be turned by 90 degrees clockwise
    texture(0).transpose(Image.Transpose.ROTATE_90).save(stream, "JPEG", quality=95, exif=exif)
    assert alike(Image.open(stream), texture(0))


def test_a_small_picture_is_not_enlarged() -> None:
    assert Impression.of(texture(0).resize((80, 60))).picture.shape == (60, 80)


def test_an_impression_can_be_turned() -> None:
    on_its_side = Impression.of(texture(0).transpose(Image.Transpose.ROTATE_90))
    assert not on_its_side.is_copy_of(Impression.of(texture(0)))
    assert on_its_side.turned(3).is_copy_of(Impression.of(texture(0)))


def test_a_test_view_that_is_a_copy_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name, picture in (("a.png", 0), ("b.png", 1), ("c.jpg", 0), ("d.png", 2)):
        texture(picture).save(tmp_path / name, quality=80)
    pose = Camera.look_at((0, 0, -3), (0, 0, 0), 400, *SIZE).world_to_camera.numpy()
    photos = [
        PosedPhoto(path.stem, path, pose, Lens(400, 400, 200, 150, *SIZE), str(path))
        for path in sorted(tmp_path.iterdir())
    ]
    loaded = LoadedPhotos.load(photos, Decoder(), [0, 1], [2, 3])
    assert "1 of 2 test views are copies of training views" in caplog.text
    assert "c of a\n" in caplog.text
    caplog.clear()
    LoadedPhotos.load([photos[0], photos[2]], Decoder(), [0, 2], [])
    assert not caplog.text
    assert torch.equal(loaded.views[2].camera.world_to_camera, torch.from_numpy(pose))
