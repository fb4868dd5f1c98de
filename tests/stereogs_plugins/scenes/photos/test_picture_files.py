"""Files of all kinds in a folder of photographs."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import Decoder
from stereogs_plugins.scenes.photos import PhotosScene
from stereogs_plugins.scenes.photos.unposed_photos import read_folder

from .photographs import load, write_pictures

FOCAL_35MM = 0xA405


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photographs(count: int, tmp_path: Path) -> None:
    write_pictures(tmp_path, count)
    with pytest.raises(SceneError, match=f"at least 3 photographs; the folder has {count}"):
        load(tmp_path)


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="does not exist"):
        load(tmp_path / "none")


def test_a_truncated_photograph(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    path = copy / "train_03.jpg"
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(SceneError, match="cannot be read") as caught:
        load(copy)
    assert str(path) in caught.value.where


def test_a_file_that_is_not_a_picture(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "1.jpg").write_text("hello")
    with pytest.raises(SceneError, match="cannot be read"):
        load(tmp_path)


def test_all_duplicates_are_listed(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    shutil.copy(tmp_path / "0.jpg", tmp_path / "copy.jpg")
    with pytest.raises(SceneError, match=r"0\.jpg and copy\.jpg are the same picture"):
        load(tmp_path)
    (tmp_path / "in").mkdir()
    shutil.copy(tmp_path / "1.jpg", tmp_path / "in" / "1.jpg")
    shutil.copy(tmp_path / "2.jpg", tmp_path / "2 (1).jpg")  # sorted before what it is a copy of
    with pytest.raises(SceneError) as caught:
        load(tmp_path)
    assert caught.value.what.splitlines()[1:] == [
        *("  2 (1).jpg is 2.jpg", "  copy.jpg is 0.jpg", "  in/1.jpg is 1.jpg")
    ]
    assert caught.value.fix == "remove from the folder: 2 (1).jpg, copy.jpg, in/1.jpg"


def test_unsupported_formats_are_errors(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "IMG_1.CR3").write_bytes(b"")
    with pytest.raises(SceneError, match=r"IMG_1\.CR3"):
        load(tmp_path)


def test_a_phones_folder(tmp_path: Path) -> None:
    dcim = tmp_path / "DCIM"
    (dcim / "100APPLE").mkdir(parents=True)
    (dcim / "101APPLE").mkdir()
    write_pictures(dcim / "100APPLE", 3)
    (dcim / "100APPLE" / "1.jpg").rename(dcim / "101APPLE" / "1.jpg")
    for name in ("Thumbs.db", "IMG_1.MOV", "IMG_1.AAE", "__MACOSX/x.jpg", ".thumbnails/y.jpg"):
        (dcim / name).parent.mkdir(exist_ok=True)
        (dcim / name).touch()
    assert PhotosScene.recognizes(tmp_path)
    assert [photo.name for photo in read_folder(tmp_path)] == [
        "DCIM/100APPLE/0.jpg",
        "DCIM/100APPLE/2.jpg",
        "DCIM/101APPLE/1.jpg",
    ]


def test_heic_is_read_with_pillow_heif(tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip("pillow_heif", reason="pip install pillow-heif")
    write_pictures(tmp_path, 2)
    picture = Image.linear_gradient("L").resize((64, 48)).convert("RGB")
    pillow_heif.from_pillow(picture).save(tmp_path / "IMG_1.HEIC", quality=95)
    photo = read_folder(tmp_path)[-1]
    assert (photo.name, photo.size) == ("IMG_1.HEIC", (64, 48))
    difference = np.asarray(picture, dtype=float) - Decoder(upright=True).read(photo.path)
    assert np.abs(difference).mean() < 4


def test_heic_without_pillow_heif(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    write_pictures(tmp_path, 3)
    for index in range(5):
        (tmp_path / f"IMG_{index}.HEIC").touch()
    with pytest.raises(SceneError) as caught:
        load(tmp_path)
    assert "IMG_0.HEIC, IMG_1.HEIC, IMG_2.HEIC and 2 more" in caught.value.what
    assert "pip install 'stereogs-plugins[heic]'" in caught.value.fix


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({}, None),
        ({FOCAL_35MM: 24}, 24 / math.hypot(36, 24) * 500 / 400),  # 400x300: diagonal 500
        ({FOCAL_35MM: 0}, None),
        ({FOCAL_35MM: 65535}, None),
        # 6 mm, 4000 pixels on 1 cm of the sensor as taken, 8 mm wide: 3200 pixels
        ({0x920A: 6.0, 0xA20E: 4000.0, 0xA210: 3, 0xA002: 3200}, 6 / 8),
        ({0x920A: 6.0, 0xA20E: 0.0, 0xA210: 3}, None),
    ],
)
def test_focal_length_by_exif(
    tags: dict[int, float], expected: float | None, tmp_path: Path
) -> None:
    write_pictures(tmp_path, 2)
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags)
    Image.new("RGB", (300, 400)).save(tmp_path / "z.jpg", exif=exif)
    focal = read_folder(tmp_path)[-1].focal
    assert focal == (None if expected is None else pytest.approx(expected, rel=1e-3))
