from __future__ import annotations

import logging
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from registry import SceneError
from stereogs_plugins.scenes.colmap import ColmapScene, stereogs_register_scenes
from tests.stereogs_plugins.building import offered
from tests.stereogs_plugins.scenes.small_scenes import (
    COLORS,
    POINTS,
    World,
    assert_sees_the_points,
    write_colmap,
)
from tests.stereogs_plugins.scenes.test_colmap_files import load, patch, rewrite

BENT = (0.7, 0.2, 0.01, -0.02)


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


MASKS = {
    "colmap": "masks/IMG_{:02d}.JPG.png",
    "nerfstudio": "masks/IMG_{:02d}.png",
    "same_name": "masks/IMG_{:02d}.JPG",
    "reduced": "masks_2/IMG_{:02d}.JPG.png",
}


@pytest.mark.parametrize("kind", MASKS)
def test_masks_exclude_pixels_and_the_points_that_only_they_show(kind: str, tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    reduced = kind == "reduced"
    if reduced:
        shutil.move(folder / "images", folder / "images_2")
    for index in range(9):
        path = folder / MASKS[kind].format(index)
        path.parent.mkdir(exist_ok=True)
        kept = np.full((48, 64), 255, np.uint8)
        column, row = World().project(index)[1].astype(int)  # the red point
        kept[row - 4 : row + 5, column - 4 : column + 5] = 0
        Image.fromarray(kept).save(path)
    settings = {"downsample": 2} if reduced else {}
    scene = load(folder, **settings)
    red = torch.tensor([1.0, 0.0, 0.0])
    for view in (*scene.train, *scene.test):
        assert view.weights is not None
        assert view.weights.sum() == 48 * 64 - 81
        assert not (view.for_training().image == red).all(dim=2).any()
    assert scene.points is not None
    assert len(scene.points) == len(POINTS) - 1
    assert scene.fact("masks") == "training and scores"
    assert load(folder, masks=False, **settings).train[0].weights is None


def test_masks_of_other_names_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "masks").mkdir()
    Image.new("L", (64, 48), 255).save(folder / "masks" / "mask0.png")
    assert load(folder).train[0].weights is None
    assert "none is named as a photograph, for example IMG_00.JPG.png" in caplog.text


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


@pytest.mark.parametrize(
    ("place", "usual"),
    [
        *((place, True) for place in ("sparse", "dense/0/sparse", ".")),
        # nerfstudio, instant-ngp, 3DGS before undistortion, hloc
        *((p, False) for p in ("colmap/sparse/0", "colmap_text", "distorted/sparse/0", "out/sfm")),
    ],
)
def test_the_model_is_found_where_programs_write_it(
    place: str, usual: bool, tmp_path: Path
) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    (folder / "sparse").rename(folder / "elsewhere")
    (folder / place).mkdir(parents=True, exist_ok=True)
    for file in (folder / "elsewhere" / "0").iterdir():
        file.rename(folder / place / file.name)
    if place.startswith("dense"):
        (folder / "images").rename(folder / "dense" / "0" / "images")
    assert ColmapScene.recognizes(folder)
    (folder / "transforms.json").touch()  # nerfstudio's ns-process-data writes both
    assert ColmapScene.recognizes(folder) == usual
    assert_sees_the_points(load(folder))


def test_of_several_models_the_largest_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    small = folder / "sparse" / "1"
    shutil.copytree(folder / "sparse" / "0", small)
    lines = (small / "images.txt").read_text().splitlines()
    (small / "images.txt").write_text("\n".join(lines[:8]))
    (folder / "sparse" / "0").rename(folder / "sparse" / "2")
    assert len(load(folder, test_every=0).train) == 9
    assert "sparse/2 (9); the others are not: sparse/1 (2)" in caplog.text


def test_several_scenes_in_one_folder_are_refused(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_colmap(tmp_path / name, World())
    with pytest.raises(SceneError, match="several scenes: one, two") as caught:
        load(tmp_path)
    assert "give the folder of one of them, or set `model`" in caught.value.fix
    assert_sees_the_points(load(tmp_path / "one"))
    assert_sees_the_points(load(tmp_path, model="two/sparse/0"))


def test_a_folder_that_cannot_be_read_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "sparse").rename(folder / "out")
    (folder / "locked").mkdir()
    iterdir = Path.iterdir

    def refusing(path: Path) -> Iterator[Path]:
        if path.name == "locked":
            raise PermissionError(path)
        return iterdir(path)

    monkeypatch.setattr(Path, "iterdir", refusing)
    assert_sees_the_points(load(folder))


def test_the_split_that_the_exporter_writes_is_read(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "sparse" / "0" / "test.txt").write_text("IMG_02.JPG\nIMG_03.JPG\n")
    scene = load(folder)
    assert [view.name for view in scene.test] == ["IMG_02", "IMG_03"]
    assert len(scene.train) == 7
    assert len(load(folder, test_every=0).train) == 9


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"other.png\n"], ids=["bytes", "names"])
def test_a_list_of_test_views_that_cannot_be_used_is_refused(
    content: bytes, tmp_path: Path
) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "sparse" / "0" / "test.txt").write_bytes(content)
    with pytest.raises(SceneError, match="the list of test views") as caught:
        load(folder)
    assert "test_every" in caught.value.fix
    assert len(load(folder, test_every=0).train) == 9


def test_a_missing_photograph_is_named_and_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "images" / "IMG_04.png").rename(folder / "images" / "unregistered.png")
    caplog.set_level(logging.INFO, "stereogs.photos")
    scene = load(folder, test_every=0)
    assert [view.name for view in scene.train] == [f"IMG_0{k}" for k in range(9) if k != 4]
    assert scene.points is not None
    assert "IMG_04.JPG" in caplog.text
    assert "pictures without a camera are not used: 1, for example unregistered.png" in caplog.text


def test_points_without_tracks_are_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    rewrite(
        folder,
        "points3D.txt",
        lambda text: "\n".join(" ".join(line.split()[:8]) for line in text.splitlines()[3:]),
    )
    points = load(folder).points
    assert points is not None
    assert len(points) == len(POINTS)
    assert "do not say which photographs" in caplog.text


def test_a_camera_far_from_the_others_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_colmap(tmp_path, World())
    near = load(folder).bounds
    # The second record: id 2, photograph 7.
    patch("images.bin", 44, "<d", 5000.0)(folder)
    scene = load(folder, test_every=0)
    assert len(scene.train) == 8
    assert "its camera is" in caplog.text
    assert scene.bounds == pytest.approx(near, rel=0.2)


def test_cameras_at_one_centre_are_refused(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")

    def at_the_origin(line: str) -> str:
        fields = line.split()
        return " ".join([*fields[:5], "1e-17", "0", "-2e-17", *fields[8:]])

    rewrite(
        folder,
        "images.txt",
        lambda text: "\n\n".join(map(at_the_origin, text.splitlines()[4::2])),
    )
    with pytest.raises(SceneError, match="the same center"):
        load(folder, points=False)


def test_a_folder_with_smaller_photographs_only(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "images").rename(folder / "images_3")
    assert load(folder).fact("source") == "images_3"


def test_an_implausible_lens(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    patch("cameras.bin", 64, "<d", 1e6)(folder)
    with pytest.raises(SceneError, match="bends the picture too much"):
        load(folder)


@pytest.mark.parametrize("place", ["input", "."])
def test_photographs_in_the_only_other_folder_are_found(place: str, tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "masks").mkdir()
    Image.new("L", (64, 48), 255).save(folder / "masks" / "IMG_00.png")
    shutil.copytree(folder / "images", folder / place, dirs_exist_ok=True)
    shutil.rmtree(folder / "images")
    assert_sees_the_points(load(folder))
    (folder / "more").mkdir()
    Image.new("RGB", (64, 48)).save(folder / "more" / "a.png")
    with pytest.raises(SceneError) as caught:
        load(folder)
    assert (
        f"(found: {', '.join(sorted((place, 'more'), reverse=place == '.'))})" in caught.value.fix
    )
    assert_sees_the_points(load(folder, images=place))


@pytest.mark.parametrize("suffix", [".HEIC", ".jpg"])
def test_heic_is_read_whatever_its_suffix(suffix: str, tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip("pillow_heif", reason="pip install pillow-heif")
    folder = write_colmap(tmp_path, World())
    for path in (folder / "images").iterdir():
        with Image.open(path) as picture:
            pillow_heif.from_pillow(picture).save(path.with_suffix(".heic"), quality=100)
        path.with_suffix(".heic").rename(path.with_suffix(suffix))
        path.unlink()
    assert_sees_the_points(load(folder), tolerance=60)
    with pytest.MonkeyPatch.context() as without:
        without.setitem(sys.modules, "pillow_heif", None)
        with pytest.raises(SceneError, match="is in the format HEIC") as caught:
            load(folder)
    assert "pip install" in caught.value.fix


def test_photographs_in_a_format_that_is_not_read(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    for path in (folder / "images").iterdir():
        path.rename(path.with_suffix(".avif"))
    with pytest.raises(SceneError, match="images are missing") as caught:
        load(folder)
    assert "convert the pictures to JPEG or PNG; .avif cannot be read" in caught.value.fix


def test_names_that_begin_with_the_folder_of_photographs(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World(), text=True, model="PINHOLE")
    rewrite(folder, "images.txt", lambda text: text.replace("IMG_", "images/IMG_"))
    assert_sees_the_points(load(folder))


def test_points_of_a_ply_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_colmap(tmp_path, World())
    expected = load(folder).points
    model = folder / "sparse" / "0"
    (model / "points3D.bin").unlink()
    kinds = [
        *(("float", name) for name in "xyz"),
        *(("uchar", c) for c in ("red", "green", "blue")),
    ]
    rows = [" ".join(map(str, (*p, *c))) for p, c in zip(POINTS, COLORS, strict=True)]
    header = ["ply", "format ascii 1.0", f"element vertex {len(rows)}"]
    header += [f"property {kind} {name}" for kind, name in kinds]
    (model / "points3D.ply").write_text("\n".join([*header, "end_header", *rows, ""]))
    points = load(folder).points
    assert points is not None
    assert expected is not None
    torch.testing.assert_close(points.positions.double(), expected.positions, atol=1e-6, rtol=0)
    torch.testing.assert_close(points.colors, expected.colors)
    assert "do not say which photographs" in caplog.text


def test_names_may_differ_in_case(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, World())
    for path in (folder / "images").iterdir():
        path.rename(path.with_name(f"{path.stem.lower()}.Png"))
    assert_sees_the_points(load(folder))


def test_transparency_and_missing_test_views_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_colmap(tmp_path, World())
    (folder / "sparse" / "0" / "test.txt").write_text("IMG_03.JPG\nIMG_99.JPG\n")
    for path in (folder / "images").iterdir():
        with Image.open(path) as opened:
            picture = opened.convert("RGBA")
        picture.putpixel((0, 0), (0, 0, 0, 0))
        picture.save(path)
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        assert [view.name for view in load(folder).test] == ["IMG_03"]
    assert "transparent pixels in 9 of 9 photographs" in caplog.text
    assert "lists 1 photographs that are missing, for example IMG_99.JPG" in caplog.text
