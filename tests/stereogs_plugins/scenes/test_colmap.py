from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import Scene, SceneError
from stereogs_plugins.scenes.colmap import ColmapScene, stereogs_register_scenes
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.scenes.small_scenes import (
    COLORS,
    POINTS,
    World,
    assert_sees_the_points,
    write_colmap,
)

BENT = (0.7, 0.2, 0.01, -0.02)


def load(folder: Path, **settings: object) -> Scene:
    return build(ColmapScene, path=folder, **settings).load()


def test_registers_as_colmap() -> None:
    assert offered(stereogs_register_scenes) == {"colmap": ColmapScene}


def test_all_photographs_are_used(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    scene = load(folder)
    assert (len(scene.train), len(scene.test)) == (7, 2)
    scene = load(folder, test_every=0)
    assert (len(scene.train), len(scene.test)) == (9, 0)


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE"])
def test_poses_lens_and_points(model: str, text: bool, tmp_path: Path) -> None:
    world = World(shift=(4.0, -3.0))
    folder = write_colmap(tmp_path, world, text=text, model=model)
    scene = load(folder, train_views=3)
    assert [view.name for view in scene.train] == ["IMG_01", "IMG_04", "IMG_07"]
    assert [view.name for view in scene.test] == ["IMG_00", "IMG_08"]
    for view in (*scene.train, *scene.test):
        expected = world.pose(int(view.name[-2:]))
        np.testing.assert_allclose(view.camera.world_to_camera.numpy(), expected, atol=1e-9)
        assert (view.camera.cx, view.camera.cy) == (36, 21)
    assert scene.points is not None
    np.testing.assert_allclose(scene.points.positions.numpy(), POINTS, atol=1e-6)
    np.testing.assert_allclose(255 * scene.points.colors.numpy(), COLORS, atol=1e-4)
    assert_sees_the_points(scene)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("SIMPLE_RADIAL", (0.7, 0.0, 0.0, 0.0)),
        ("SIMPLE_RADIAL", (-0.7, 0.0, 0.0, 0.0)),
        ("RADIAL", (0.7, 0.2, 0.0, 0.0)),
        ("OPENCV", BENT),
        ("FULL_OPENCV", BENT),
    ],
)
def test_distorted_photographs_are_undistorted(
    model: str, distortion: tuple[float, float, float, float], tmp_path: Path
) -> None:
    world = World(width=256, height=192, shift=(9.0, -5.0), distortion=distortion)
    scene = load(write_colmap(tmp_path, world, model=model))
    assert_sees_the_points(scene, tolerance=60)  # bilinear: the squares' edges are soft
    straight = World(width=256, height=192, shift=(9.0, -5.0))
    bent_by = np.abs(world.project(1) - straight.project(1)).max()
    assert bent_by > 2  # the squares reach 1.5 pixels: it would have missed without
    assert "undistorted" in str(scene.fact("changed"))


def test_photographs_at_another_size(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(shift=(4.0, -2.0)), model="PINHOLE")
    (folder / "images_2").mkdir()
    for path in (folder / "images").iterdir():
        Image.open(path).resize((32, 24)).save(folder / "images_2" / f"{path.stem}.jpg")
    stored = load(folder, downsample=2)
    camera = stored.train[0].camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (32, 24, 18, 11)
    assert camera.fx == pytest.approx(World().focal / 2)
    assert stored.fact("source") == "images_2"
    resized = load(folder, downsample=2, image_source="resize", resize_filter="lanczos")
    assert resized.train[0].image.shape == (24, 32, 3)
    assert resized.fact("source") == "images"
    assert resized.fact("changed") == "resized from 64x48 to 32x24 with the lanczos filter"


def test_points_need_two_training_views(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    path = folder / "sparse" / "0" / "points3D.txt"
    lines = path.read_text().splitlines()
    records = [line for line in lines if not line.startswith("#")]
    # Ids count down: id 9 is photograph 0, id 8 photograph 1. Twice the same view is one view.
    fields = records[0].split()
    fields[8:] = ["8", "0", "8", "1", "9", "0"]
    path.write_text("\n".join([" ".join(fields), *records[1:]]))
    points = load(folder).points
    assert points is not None
    assert len(points) == len(POINTS) - 1
    assert load(folder, points=False).points is None


def test_names_with_folders_and_spaces(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    path = folder / "sparse" / "0" / "images.txt"
    text = path.read_text()
    for index in range(9):
        old, new = f"IMG_{index:02d}", f"camera {index % 2}/IMG_{index // 2:02d}"
        (folder / "images" / new).parent.mkdir(exist_ok=True)
        (folder / "images" / f"{old}.png").rename(folder / "images" / f"{new}.png")
        text = text.replace(f"{old}.JPG", f"{new}.png")
    path.write_text(text)
    (folder / "images" / "keep.png").write_bytes(b"")
    scene = load(folder)
    assert scene.test[0].name == "camera 0_IMG_00"
    assert_sees_the_points(scene)


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
    "no model": (lambda f: (f / "sparse").rename(f / "dense"), "cannot be read"),
    "cut cameras": (cut("cameras.bin"), "in the middle of a record"),
    "cut images": (cut("images.bin"), "cannot be read"),
    "cut points": (cut("points3D.bin"), "too short for"),
    "many cameras": (patch("cameras.bin", 0, "<Q", 2**60), "too short for"),
    "unknown model": (patch("cameras.bin", 12, "<i", 7), "camera model 7 is not one of"),
    "zero width": (patch("cameras.bin", 16, "<Q", 0), "image width is 0"),
    "other shape": (patch("cameras.bin", 16, "<Q", 200), "another shape"),
    "negative focal": (patch("cameras.bin", 32, "<d", -5.0), "focal length fx is -5"),
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
    "no photograph": (lambda f: (f / "images" / "IMG_04.png").unlink(), "photograph is missing"),
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


def test_an_implausible_lens(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    patch("cameras.bin", 64, "<d", 1e6)(folder)
    with pytest.raises(SceneError, match="bends the picture too much"):
        load(folder)


@pytest.mark.parametrize(
    "line", ["1 PINHOLE 64 48 80 80 32", "1 NEW 64 48 80", "1 PINHOLE x 48 1 1 1 1"]
)
def test_a_damaged_text_file(line: str, tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    (folder / "sparse" / "0" / "cameras.txt").write_text(line)
    with pytest.raises(SceneError, match="COLMAP model cannot be read"):
        load(folder)
