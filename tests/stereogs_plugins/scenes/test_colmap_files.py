"""COLMAP's files as other programs and systems write them, and damaged ones."""

from __future__ import annotations

import logging
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from registry import Scene, SceneError
from stereogs_plugins.scenes.colmap import ColmapScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.small_scenes import (
    COLORS,
    World,
    assert_sees_the_points,
    write_colmap,
)


def load(folder: Path, **settings: object) -> Scene:
    return build(ColmapScene, path=folder, **settings).load()


def patch(name: str, offset: int, layout: str, value: object) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "sparse" / "0" / name
        data = bytearray(path.read_bytes())
        struct.pack_into(layout, data, offset, value)
        path.write_bytes(data)

    return damage


def rename_images(new: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "sparse" / "0" / "images.bin"
        path.write_bytes(path.read_bytes().replace(b"IMG_04.JPG", new.encode()))

    return damage


def cut(name: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "sparse" / "0" / name
        path.write_bytes(path.read_bytes()[:-1])

    return damage


NAN = float("nan")


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no model": (lambda f: shutil.rmtree(f / "sparse"), "cannot be read"),
    "cut cameras": (cut("cameras.bin"), "in the middle of a record"),
    "cut images": (cut("images.bin"), "cannot be read"),
    "cut points": (cut("points3D.bin"), "too short for"),
    "many cameras": (patch("cameras.bin", 0, "<Q", 2**60), "too short for"),
    "unknown model": (patch("cameras.bin", 12, "<i", 16), "EUCM is not one of"),
    "model of the future": (patch("cameras.bin", 12, "<i", 99), "colmap image_undistorter"),
    "panorama": (patch("cameras.bin", 12, "<i", 17), "cut the panoramas"),
    "no images": (lambda f: (f / "sparse" / "0" / "images.bin").unlink(), "images.bin"),
    "zero width": (patch("cameras.bin", 16, "<Q", 0), "image width is 0"),
    "other shape": (patch("cameras.bin", 16, "<Q", 200), "another shape"),
    "negative focal": (patch("cameras.bin", 32, "<d", -5.0), "focal length fx is -5"),
    "centre at a corner": (patch("cameras.bin", 48, "<16s", bytes(16)), "the principal point"),
    "nan focal": (patch("cameras.bin", 32, "<d", NAN), "focal length fx is nan"),
    "tiny focal": (patch("cameras.bin", 32, "<d", 1e-9), "focal length fx is 1e-09 px"),
    "nan principal point": (patch("cameras.bin", 48, "<d", NAN), "not finite"),
    "nan rotation": (patch("images.bin", 12, "<d", NAN), "is not finite"),
    "long rotation": (patch("images.bin", 12, "<d", 3.0), "not 1"),
    "infinite translation": (patch("images.bin", 44, "<d", -np.inf), "is not finite"),
    "far away": (patch("images.bin", 44, "<d", 1e200), "too far away"),
    "no such camera": (patch("images.bin", 68, "<i", 5), "has camera 5"),
    "nan point": (patch("points3D.bin", 16, "<d", NAN), "point 0 is not finite"),
    "climbing name": (rename_images("../a/b.png"), "does not stay inside"),
    "absolute name": (rename_images("/etc/host1"), "does not stay inside"),
    "same name": (rename_images("IMG_05.JPG"), "two images are named 'IMG_05.JPG'"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=list(DAMAGES))
def test_bad_input_is_an_error(
    damage: Callable[[Path], object], message: str, tmp_path: Path
) -> None:
    folder = write_colmap(tmp_path, World(), model="PINHOLE")
    # The first record of images.bin is photograph 8, a test view, for COLMAP writes by id.
    damage(folder)
    with pytest.raises(SceneError) as caught:
        load(folder)
    assert message in caught.value.what
    assert caught.value.where


def rewrite(folder: Path, name: str, change: Callable[[str], str]) -> None:
    path = folder / "sparse" / "0" / name
    path.write_bytes(change(path.read_text()).encode())


def without_features(text: str) -> str:
    """Only the lines of the poses, with names of several words."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return "\n".join(line.replace("IMG_", "my holiday ") for line in lines[::2])


def test_text_files_without_lines_of_features(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    rewrite(folder, "images.txt", without_features)
    (folder / "sparse" / "0" / "points3D.txt").unlink()
    for file in (folder / "images").iterdir():
        file.rename(file.with_name(file.name.replace("IMG_", "my holiday ")))
    scene = load(folder, test_every=0)
    assert len(scene.train) == 9
    assert_sees_the_points(scene)


def test_text_files_of_other_systems(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Marks of UTF-8 and UTF-16, line ends of Windows, fractions, backslashes, decomposed accents."""
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    rewrite(folder, "cameras.txt", lambda text: "\ufeff" + text.replace(" 64 48 ", " 64.0 48.0 "))
    name = "caf\u00e9"
    rewrite(folder, "images.txt", lambda text: text.replace("IMG_03", f"{name}\\IMG_03"))
    for file in ("cameras.txt", "images.txt", "points3D.txt"):
        rewrite(folder, file, lambda text: text.replace("\n", "\r\n"))
    points = folder / "sparse" / "0" / "points3D.txt"
    text = points.read_text()
    for color in COLORS:
        whole = " ".join(map(str, color))
        text = text.replace(f" {whole} ", f" {whole.replace(' ', '.0 ')}.0 ")
    points.write_text(text, "utf-16")
    (folder / "images" / name).mkdir()
    (folder / "images" / "IMG_03.png").rename(folder / "images" / name / "IMG_03.png")
    rewrite(folder, "images.txt", lambda text: text.replace("IMG_04", "\u00e9_04"))
    (folder / "images" / "IMG_04.png").rename(folder / "images" / "e\u0301_04.png")
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        scene = load(folder, test_every=0)
    assert "without a camera" not in caplog.text
    assert len(scene.train) == 9
    assert_sees_the_points(scene)
    assert scene.points is not None
    np.testing.assert_allclose(255 * scene.points.colors.numpy(), COLORS, atol=1e-4)


def test_fisheye_models_with_fewer_coefficients(tmp_path: Path) -> None:
    """The radial fisheyes are OPENCV_FISHEYE with coefficients of 0; FOV and THIN_PRISM are COLMAP's own."""
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    focal = World().focal
    images = []
    for line in (
        f"1 OPENCV_FISHEYE 64 48 {focal} {focal} 32 24 0.01 0.002 0 0",
        f"1 RADIAL_FISHEYE 64 48 {focal} 32 24 0.01 0.002",
        f"1 THIN_PRISM_FISHEYE 64 48 {focal} {focal} 32 24 0.01 0.002 0 0 0 0 0 0",
        f"1 FOV 64 48 {focal} {focal} 32 24 0.5",
    ):
        (folder / "sparse" / "0" / "cameras.txt").write_text(line)
        images.append(load(folder).train[0].image)
    np.testing.assert_array_equal(images[0].numpy(), images[1].numpy())
    np.testing.assert_allclose(images[0].numpy(), images[2].numpy(), atol=2 / 255)
    assert images[3].shape != images[0].shape
    for line in (
        f"1 FISHEYE 64 48 {focal} {focal} 32 24",
        f"1 SIMPLE_FISHEYE 64 48 {focal} 32 24",
        f"1 OPENCV_FISHEYE 64 48 {focal} {focal} 32 24 0 0 0 0",
    ):
        (folder / "sparse" / "0" / "cameras.txt").write_text(line)
        images.append(load(folder).train[0].image)
    np.testing.assert_array_equal(images[-1].numpy(), images[-2].numpy())
    np.testing.assert_array_equal(images[-1].numpy(), images[-3].numpy())


@pytest.mark.parametrize(
    "line", ["1 PINHOLE 64 48 80 80 32", "1 NEW 64 48 80", "1 PINHOLE x 48 1 1 1 1"]
)
def test_a_damaged_text_file(line: str, tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    (folder / "sparse" / "0" / "cameras.txt").write_text(line)
    with pytest.raises(SceneError, match="COLMAP model cannot be read"):
        load(folder)
