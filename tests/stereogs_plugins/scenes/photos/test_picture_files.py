"""Files of all kinds in a folder of photographs."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from registry import SceneError
from registry.toolkit.drawing import DRAWN, save_png
from registry.toolkit.photos import Decoder
from stereogs_plugins.scenes.photos import PhotosScene
from stereogs_plugins.scenes.photos.loader import _warn_of_grey
from stereogs_plugins.scenes.photos.picture_files import readable_pictures
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.stereogs_plugins.scenes.photos.photographs import (
    EXIF_BLOCK,
    FOCAL_35MM,
    load,
    write_pictures,
)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photographs(count: int, tmp_path: Path) -> None:
    write_pictures(tmp_path, count)
    with pytest.raises(SceneError, match=f"at least 3 photographs, .*; the folder has {count}"):
        load(tmp_path)


def test_raw_files_alone_need_to_be_converted(tmp_path: Path) -> None:
    for name in range(20):
        (tmp_path / f"{name:02}.dng").write_bytes(b"II*\0")
    with pytest.raises(SceneError, match="the folder has 0") as caught:
        load(tmp_path)
    assert "convert those left out" in caught.value.fix
    (line,) = caught.value.what.splitlines()[1:]
    assert line.startswith("  left out: 00.dng, ")
    assert line.endswith("more: unsupported format; convert it to JPEG or PNG")


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="does not exist"):
        load(tmp_path / "none")


def reasons(folder: Path) -> dict[str, str]:
    """Why files of a folder are left out, by name."""
    return {str(path.relative_to(folder)): why for path, why in read_folder(folder).left_out}


def test_the_picture_that_check_draws_is_left_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    save_png(torch.rand(20, 30, 3), tmp_path / "check.png", {DRAWN: "stereogs check"})
    save_png(torch.rand(20, 30, 3), tmp_path / "other.png", {DRAWN: "a camera's program"})
    pictures, _, left_out = readable_pictures(tmp_path)
    assert len(pictures) == 4
    assert [(file.path.name, file.reason) for file in left_out] == [
        ("check.png", "drawn by `stereogs check`")
    ]


def test_pictures_in_other_formats_are_left_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "1.CR3").touch()
    (tmp_path / "IMG_1.CR3").touch()
    Image.fromarray(np.full((30, 40), 1000, dtype=np.uint16)).save(tmp_path / "3.png")
    why = reasons(tmp_path)
    assert "same picture in a supported format" in why["1.CR3"]
    assert "convert it to JPEG or PNG" in why["IMG_1.CR3"]
    assert why["3.png"].endswith("not 8 bits per channel")


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_a_truncated_photograph_is_left_out(suffix: str, tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    path = tmp_path / f"3.{suffix}"
    Image.effect_noise((200, 200), 50).save(path)
    path.write_bytes(path.read_bytes()[:-2000])
    assert [photo.name for photo in read_folder(tmp_path).photos] == ["0.jpg", "1.jpg", "2.jpg"]
    assert "the photograph cannot be read" in reasons(tmp_path)[path.name]


def test_a_file_that_is_not_a_picture_is_left_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "1.jpg").write_text("hello")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(SceneError, match="the folder has 2") as caught:
        load(tmp_path)
    assert "left out: 1.jpg: the photograph cannot be read" in caught.value.what
    write_pictures(tmp_path, 3)
    cameras = ("cameras.xml", "00000000_cam.txt", "poses.txt", "cam_12.csv", "KRT_intrinsics.txt")
    for name in ("database.db", "campus.txt", *cameras):
        (tmp_path / name).touch()
    assert reasons(tmp_path) == {
        **dict.fromkeys(cameras, "cameras of another program; export them for COLMAP to use them"),
        "campus.txt": "not a picture",
        "database.db": "a database of matches; they are found anew",
        "notes.txt": "not a picture",
    }


def test_copies_are_left_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    shutil.copy(tmp_path / "0.jpg", tmp_path / "copy.jpg")
    (tmp_path / "in").mkdir()
    shutil.copy(tmp_path / "1.jpg", tmp_path / "in" / "1.jpg")
    shutil.copy(tmp_path / "2.jpg", tmp_path / "2 (1).jpg")  # sorted before what it is a copy of
    assert [photo.name for photo in read_folder(tmp_path).photos] == ["0.jpg", "1.jpg", "2.jpg"]
    assert reasons(tmp_path) == {
        "2 (1).jpg": "a copy of 2.jpg",
        "copy.jpg": "a copy of 0.jpg",
        "in/1.jpg": "a copy of 1.jpg",
    }


def test_the_best_of_copies_in_other_formats_and_sizes_stays(tmp_path: Path) -> None:
    write_pictures(tmp_path, 2)
    picture = Image.effect_noise((80, 60), 80).resize((320, 240), Image.Resampling.BICUBIC)
    for name in ("images_2", "web", "runs/demo/renders", "old"):
        (tmp_path / name).mkdir(parents=True)
    picture.save(tmp_path / "IMG_1.jpg", quality=90)
    picture.resize((160, 120)).save(tmp_path / "images_2" / "IMG_1.png")
    picture.save(tmp_path / "web" / "IMG_1.webp", quality=60)
    picture.filter(ImageFilter.GaussianBlur(2)).save(tmp_path / "old" / "render.png")
    picture.transpose(Image.Transpose.ROTATE_180).save(tmp_path / "old" / "u.jpg", quality=50)
    picture.save(tmp_path / "runs" / "demo" / "renders" / "IMG_1.png")
    for name in ("pipeline.yaml", "provenance.json"):
        (tmp_path / "runs" / "demo" / name).touch()
    assert PhotosScene.recognizes(tmp_path)
    assert [photo.name for photo in read_folder(tmp_path).photos] == ["0.jpg", "1.jpg", "IMG_1.jpg"]
    assert reasons(tmp_path) == {
        "images_2/IMG_1.png": "a copy of IMG_1.jpg, of 160x120 pixels only",
        "web/IMG_1.webp": "a copy of IMG_1.jpg",
        "old/render.png": "a copy of IMG_1.jpg",
        "old/u.jpg": "a copy of IMG_1.jpg",
        "runs/demo": "the folder of a training run",
    }


def test_of_a_grey_and_a_coloured_copy_the_coloured_one_stays(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_pictures(tmp_path, 2)
    noise = Image.effect_noise((80, 60), 80).resize((320, 240), Image.Resampling.BICUBIC)
    noise.convert("RGB").save(tmp_path / "a.png")
    Image.merge("RGB", [noise, noise.point(lambda v: v // 2), noise]).save(tmp_path / "b.jpg")
    noise.transpose(Image.Transpose.FLIP_TOP_BOTTOM).save(tmp_path / "c.jpe")
    photos = read_folder(tmp_path).photos
    assert [(photo.name, photo.grey) for photo in photos] == [
        ("0.jpg", True),
        ("1.jpg", False),
        ("b.jpg", False),
        ("c.jpe", True),
    ]
    _warn_of_grey(photos)
    assert "2 of 4 photographs are grey, for example 0.jpg" in caplog.text


def test_an_animation_is_left_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    frames = [Image.effect_noise((40, 30), sigma) for sigma in (20, 60)]
    for name in ("a.webp", "a.png"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
    assert reasons(tmp_path) == dict.fromkeys(["a.png", "a.webp"], "an animation, not a photograph")


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
    assert [photo.name for photo in read_folder(tmp_path).photos] == [
        "DCIM/100APPLE/0.jpg",
        "DCIM/100APPLE/2.jpg",
        "DCIM/101APPLE/1.jpg",
    ]


def test_heic_is_read_with_pillow_heif(tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip("pillow_heif", reason="pip install pillow-heif")
    write_pictures(tmp_path, 2)
    picture = Image.linear_gradient("L").resize((64, 48)).convert("RGB")
    pillow_heif.from_pillow(picture).save(tmp_path / "IMG_1.HEIC", quality=95)
    photo = read_folder(tmp_path).photos[-1]
    assert (photo.name, photo.size) == ("IMG_1.HEIC", (64, 48))
    difference = np.asarray(picture, dtype=float) - Decoder(upright=True).read(photo.path)
    assert np.abs(difference).mean() < 4


def test_heic_without_pillow_heif(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    write_pictures(tmp_path, 3)
    for index in range(5):
        (tmp_path / f"IMG_{index}.HEIC").touch()
    assert len(read_folder(tmp_path).photos) == 3
    assert "pip install 'stereogs-plugins[heic]'" in reasons(tmp_path)["IMG_4.HEIC"]


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
    exif.get_ifd(EXIF_BLOCK).update(tags)
    Image.new("RGB", (300, 400)).save(tmp_path / "z.jpg", exif=exif)
    focal = read_folder(tmp_path).photos[-1].focal
    assert focal == (None if expected is None else pytest.approx(expected, rel=1e-3))


def test_descriptions_of_pictures_are_companions(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "0.jpg.supplemental-metadata.json").write_text("{}")
    assert PhotosScene.recognizes(tmp_path)
    (tmp_path / "transforms.json").write_text("{}")
    assert not PhotosScene.recognizes(tmp_path)
