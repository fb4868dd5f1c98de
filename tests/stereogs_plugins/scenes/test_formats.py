"""Properties of every loader of real pictures: cameras, colours and names match."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from registry import Scene, SceneLoader
from stereogs_plugins.scenes.blender import BlenderScene
from stereogs_plugins.scenes.colmap import ColmapScene
from stereogs_plugins.scenes.dtu import DTUScene
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.nerfstudio import NerfstudioScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    World,
    assert_sees_the_points,
    write_blender,
    write_colmap,
    write_dtu,
    write_llff,
    write_nerfstudio,
)

Case = tuple[type[SceneLoader[Any]], Callable[[Path, World], Path], World, dict[str, Any]]
OFF_CENTER = World(shift=(3.0, -2.0))
CASES: dict[str, Case] = {
    "llff": (LLFFScene, write_llff, World(), {"downsample": 2}),
    "blender": (BlenderScene, write_blender, World(), {"train_ids": (1, 3, 5)}),
    "dtu": (DTUScene, write_dtu, World(count=DTU_VIEWS, shift=(3.0, -2.0)), {}),
    "colmap": (ColmapScene, write_colmap, OFF_CENTER, {}),
    "nerfstudio": (NerfstudioScene, write_nerfstudio, OFF_CENTER, {}),
}


@pytest.fixture(params=CASES.values(), ids=list(CASES))
def case(request: pytest.FixtureRequest) -> Case:
    found: Case = request.param
    return found


def load(case: Case, folder: Path) -> Scene:
    loader, write, world, settings = case
    return build(loader, path=write(folder, world), **settings).load()


def test_points_are_where_the_cameras_say(case: Case, tmp_path: Path) -> None:
    assert_sees_the_points(load(case, tmp_path))


def test_intrinsics_are_the_true_ones(case: Case, tmp_path: Path) -> None:
    world = case[2]
    camera = load(case, tmp_path).train[0].camera
    found = (camera.fx, camera.fy, camera.cx, camera.cy)
    assert found == pytest.approx((world.focal, world.focal, *world.principal_point), abs=1e-6)


def test_facts(case: Case, tmp_path: Path) -> None:
    scene = load(case, tmp_path)
    assert scene.fact("changed") == "nothing"
    for name, views in (("train_photographs", scene.train), ("test_photographs", scene.test)):
        numbers = scene.fact(name)
        assert isinstance(numbers, tuple)
        assert len(numbers) == len(views)


def test_bounds_enclose_the_points(case: Case, tmp_path: Path) -> None:
    scene = load(case, tmp_path)
    for view in scene.train:
        pose = view.camera.world_to_camera.numpy()
        depth = np.zeros(3) @ pose[2, :3] + pose[2, 3]
        assert scene.bounds[0] < depth < scene.bounds[1]


def test_only_its_loader_recognizes_a_folder(case: Case, tmp_path: Path) -> None:
    loader, write, world, _ = case
    folder = write(tmp_path, world)
    assert [other for other, *_ in CASES.values() if other.recognizes(folder)] == [loader]
    assert not loader.recognizes(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["llff", "colmap", "nerfstudio"])
def test_larger_photographs_are_reduced_and_smaller_ones_kept(name: str, tmp_path: Path) -> None:
    loader, write, world, settings = CASES[name]
    folder = write(tmp_path, world)
    reduced, kept = (
        build(loader, path=folder, **settings, max_size=size).load().train[0].camera
        for size in (32, 1000)
    )
    assert (reduced.width, reduced.height) == (world.width // 2, world.height // 2)
    assert (reduced.fx, reduced.cx) == pytest.approx(
        (world.focal / 2, world.principal_point[0] / 2), abs=1e-6
    )
    assert (kept.width, kept.height) == (world.width, world.height)


@pytest.mark.parametrize("naming", ["{}.png", "{}"])
@pytest.mark.parametrize("name", ["llff", "colmap", "nerfstudio"])
def test_masks_beside_the_photographs_exclude_pixels(
    name: str, naming: str, tmp_path: Path
) -> None:
    loader, write, world, settings = CASES[name]
    folder = write(tmp_path, world)
    kept = np.full((world.height, world.width), 255, np.uint8)
    kept[10:20, 5:] = 0
    for photo in folder.glob("images*/*"):
        mask = folder / photo.parent.name.replace("images", "masks") / naming.format(photo.name)
        mask.parent.mkdir(exist_ok=True)
        Image.fromarray(kept).save(mask)
    scene = build(loader, path=folder, **settings).load()
    for view in (*scene.train, *scene.test):
        for layer in (view.weights, view.mask):
            assert layer is not None
            np.testing.assert_array_equal(layer.numpy(), kept == 255)
    assert build(loader, path=folder, masks=False, **settings).load().train[0].mask is None


ORIENTATIONS = {3: 2, 6: 1, 8: 3}
"""Counterclockwise quarter turns from the upright to the stored pixels, by EXIF orientation."""
TURNED = [
    *(
        (name, "stored", k)
        for name in ("llff", "colmap", "nerfstudio", "blender")
        for k in (3, 6, 8)
    ),
    # Half a turn does not show in the size, and blender's files have none.
    *((name, "upright", k) for name in ("llff", "colmap", "nerfstudio") for k in (6, 8)),
]


@pytest.mark.parametrize("square", [False, True])
@pytest.mark.parametrize(("name", "calibrated", "orientation"), TURNED)
def test_photographs_are_turned_if_their_cameras_only_fit_then(
    name: str,
    calibrated: str,
    orientation: int,
    square: bool,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    loader, write, world, settings = CASES[name]
    folder = write(tmp_path, replace(world, height=world.width if square else world.height))
    exif = Image.Exif()
    exif[0x0112] = orientation
    turned = calibrated == "upright" and not square
    for path in folder.rglob("*.png"):
        with Image.open(path) as opened:
            pixels = np.rot90(np.asarray(opened), ORIENTATIONS[orientation] if turned else 0)
        Image.fromarray(pixels.copy()).save(path, exif=exif)
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        assert_sees_the_points(build(loader, path=folder, **settings).load())
    assert ("turned by their EXIF data" in caplog.text) == turned
    assert ("those of the pixels as stored" in caplog.text) != turned
