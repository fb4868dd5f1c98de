from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from registry import Scene, SceneError
from stereogs_plugins.scenes.blender import (
    STANDARD_VIEWS,
    BlenderScene,
    stereogs_register_scenes,
)
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.scenes.small_scenes import World, write_blender


def load(folder: Path, **settings: object) -> Scene:
    return build(BlenderScene, path=folder, **{"train_ids": (1, 3, 5), **settings}).load()


def test_registers_as_blender() -> None:
    assert offered(stereogs_register_scenes) == {"blender": BlenderScene}


def test_numbers_of_file_names_choose_the_views(tmp_path: Path) -> None:
    scene = load(write_blender(tmp_path, World()), train_ids=(5, 2), test_every=4)
    assert [view.name for view in scene.train] == ["train_r_5", "train_r_2"]
    assert [view.name for view in scene.test] == ["test_r_0", "test_r_4", "test_r_8"]
    assert len(load(write_blender(tmp_path / "all", World()), train_ids=None).train) == 9
    assert not load(tmp_path, train_ids=(5, 2), test_every=0).test


@pytest.mark.parametrize(("background", "level"), [("white", 1.0), ("black", 0.0)])
def test_transparent_pixels_take_the_background(
    background: str, level: float, tmp_path: Path
) -> None:
    scene = load(write_blender(tmp_path, World()), background=background)
    assert scene.background == (level,) * 3
    assert scene.train[0].image[0, 0].tolist() == [level] * 3
    assert background in str(scene.fact("transparent_pixels"))


def test_half_transparent_pixels_are_mixed(tmp_path: Path) -> None:
    folder = write_blender(tmp_path, World())
    pixels = np.full((48, 64, 4), 100, dtype=np.uint8)
    Image.fromarray(pixels).save(folder / "train" / "r_1.png")
    image = load(folder).train[0].image
    expected = 100 / 255 * 100 / 255 + (1 - 100 / 255)
    torch.testing.assert_close(image, torch.full_like(image, expected), atol=1 / 255, rtol=0)


def test_larger_photographs_are_reduced_and_facts_report_it(tmp_path: Path) -> None:
    scene = load(write_blender(tmp_path, World()), width=32, resize_filter="box")
    view = scene.train[0]
    assert view.image.shape == (24, 32, 3)
    assert view.camera.fx == pytest.approx(World().focal / 2)
    assert scene.fact("changed") == "resized from 64x48 to 32x24 with the box filter"


def change(folder: Path, key: str, value: Any) -> None:
    path = folder / "transforms_train.json"
    content = json.loads(path.read_text())
    target = content if key in content else content["frames"][1]
    target[key] = value
    path.write_text(json.dumps(content))


def matrix(**entries: float) -> list[list[float]]:
    rows = np.eye(4)
    for place, value in entries.items():
        rows[int(place[1]), int(place[2])] = value
    return list(rows.tolist())


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no file": (lambda f: (f / "transforms_test.json").unlink(), "transforms_test.json is missing"),
    "no json": (lambda f: (f / "transforms_train.json").write_text("{"), "cannot be read"),
    "no angle": (lambda f: change(f, "camera_angle_x", None), "'camera_angle_x' is missing"),
    "flat angle": (lambda f: change(f, "camera_angle_x", 3.2), "'camera_angle_x' cannot be used"),
    "nan": (
        lambda f: change(f, "transform_matrix", matrix(_03=float("nan"))),
        "frames.1.transform_matrix",
    ),
    "infinite": (
        lambda f: change(f, "transform_matrix", matrix(_03=float("inf"))),
        "frames.1.transform_matrix",
    ),
    "short": (lambda f: change(f, "transform_matrix", matrix()[:2]), "frames.1.transform_matrix"),
    "text": (lambda f: change(f, "transform_matrix", "identity"), "frames.1.transform_matrix"),
    "scaled": (lambda f: change(f, "transform_matrix", matrix(_00=2.0)), "not a rotation"),
    "rough": (lambda f: change(f, "transform_matrix", matrix(_01=4e-4)), "not orthonormal"),
    "last row": (lambda f: change(f, "transform_matrix", matrix(_33=2.0)), "last row"),
    "climbs": (lambda f: change(f, "file_path", "../r_1"), "does not stay inside"),
    "absolute": (lambda f: change(f, "file_path", "/r_1"), "does not stay inside"),
    "no number": (lambda f: change(f, "file_path", "train/one"), "does not end in a unique number"),
    "twice": (lambda f: change(f, "file_path", "train/r_2"), "does not end in a unique number"),
    "no image": (lambda f: (f / "train" / "r_3.png").unlink(), "photograph is missing"),
    "bad image": (lambda f: (f / "train" / "r_3.png").write_bytes(b"x"), "image cannot be read"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=list(DAMAGES))
def test_bad_input_is_an_error(
    damage: Callable[[Path], object], message: str, tmp_path: Path
) -> None:
    folder = write_blender(tmp_path, World())
    damage(folder)
    with pytest.raises(SceneError) as caught:
        load(folder)
    assert message in caught.value.what
    assert caught.value.where
    assert caught.value.fix


def test_missing_numbers(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"\[77, 78\] are missing"):
        load(write_blender(tmp_path, World()), train_ids=(1, 77, 78))


@pytest.mark.parametrize(("name", "trained"), [("r_{}", 8), ("{:04}", 94), ("r_1{:02}", 94)])
def test_the_standard_views_train_only_in_a_scene_of_nerf(
    name: str, trained: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "stereogs.photos")
    folder = write_blender(tmp_path, World(width=8, height=6, count=94))
    frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
    for number, frame in enumerate(frames):
        frame["file_path"] = f"train/{name.format(number)}"
        (folder / "train" / f"r_{number}.png").rename(folder / f"{frame['file_path']}.png")
    change_cameras(folder, frames=frames)
    assert len(build(BlenderScene, path=folder).load().train) == trained
    assert ("all 94 photographs train" in caplog.text) == (trained == 94)
    if trained == 94 and name.startswith("r_"):
        with pytest.raises(SceneError, match="are missing"):
            load(folder, train_ids=STANDARD_VIEWS)  # as a protocol says


def test_no_test_view_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_blender(tmp_path, World())
    assert load(folder, test_every=9).test
    assert not caplog.text
    content = json.loads((folder / "transforms_test.json").read_text())
    content["frames"] = content["frames"][1:]
    (folder / "transforms_test.json").write_text(json.dumps(content))
    assert not load(folder, test_every=9).test
    assert "`test_every: 1` tests all" in caplog.text


def test_lego_is_the_published_scene() -> None:
    scene = build(BlenderScene, path=data_folder("blender_lego")).load()
    numbers = [2, 16, 26, 55, 73, 76, 86, 93]
    assert [view.name for view in scene.train] == [f"train_r_{k}" for k in numbers]
    assert [view.name for view in scene.test] == [f"test_r_{8 * k}" for k in range(25)]
    for view in (*scene.train, *scene.test):
        camera = view.camera
        assert (camera.width, camera.height) == (400, 400)
        assert camera.fx == pytest.approx(555.56, abs=0.01)
        assert float(camera.center.norm()) == pytest.approx(4.03, abs=0.01)
        # The object is dark against white, and stands at the origin.
        assert float(view.image[195:205, 195:205].mean()) < 0.95
        assert view.image[0, 0].tolist() == [1, 1, 1]


def test_a_repeated_number(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="is repeated"):
        load(write_blender(tmp_path, World()), train_ids=(2, 5, 2))


def change_cameras(folder: Path, **fields: object) -> Path:
    path = folder / "transforms_train.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))
    return folder


def test_further_lens_fields_are_used(tmp_path: Path) -> None:
    folder = change_cameras(write_blender(tmp_path, World()), cx=20.0, cy=30.0, fl_y=100.0)
    camera = load(folder).train[0].camera
    assert (camera.cx, camera.cy, camera.fy) == (20, 30, 100)
    assert camera.fx == pytest.approx(World().focal)


@pytest.mark.parametrize("fields", [{"k1": 0.1}, {"is_fisheye": True}])
def test_a_distorted_lens_is_refused(fields: dict[str, object], tmp_path: Path) -> None:
    folder = change_cameras(write_blender(tmp_path, World()), **fields)
    with pytest.raises(SceneError, match="the lens is distorted") as caught:
        load(folder)
    assert "nerfstudio" in caught.value.fix


def test_a_lens_of_a_single_frame_is_refused(tmp_path: Path) -> None:
    folder = write_blender(tmp_path, World())
    angle = json.loads((folder / "transforms_train.json").read_text())["camera_angle_x"]
    frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
    change_cameras(folder, frames=[{**frame, "camera_angle_x": angle} for frame in frames])
    assert load(folder).train[0].camera.fx == pytest.approx(World().focal)
    change_cameras(folder, frames=[{**frame, "camera_angle_x": 0.9 * angle} for frame in frames])
    with pytest.raises(SceneError, match="the frame has its own 'camera_angle_x'") as caught:
        load(folder)
    assert "nerfstudio" in caught.value.fix


def test_the_focal_length_may_stand_for_the_angle(tmp_path: Path) -> None:
    folder = change_cameras(write_blender(tmp_path, World()), camera_angle_x=None, fl_x=70.0)
    assert load(folder).train[0].camera.fx == 70
    with pytest.raises(SceneError, match="'camera_angle_x' is missing"):
        load(change_cameras(folder, fl_x=None))


def test_test_views_that_were_not_rendered(tmp_path: Path) -> None:
    folder = write_blender(tmp_path, World())
    shutil.rmtree(folder / "test")
    with pytest.raises(SceneError, match="a photograph is missing") as caught:
        load(folder)
    assert "test_every: 0" in caught.value.fix
    assert len(load(folder, test_every=0).train) == 3


def test_without_test_views_their_file_is_not_needed(tmp_path: Path) -> None:
    folder = write_blender(tmp_path, World())
    (folder / "transforms_test.json").unlink()
    assert len(load(folder, train_ids=None, test_every=0).train) == 9
    with pytest.raises(SceneError, match=r"transforms_test.json is missing") as caught:
        load(folder)
    assert "test_every: 0" in caught.value.fix
