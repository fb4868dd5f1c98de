"""Scenes of photographs without poses."""

from __future__ import annotations

import logging
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from registry import Scene, SceneError
from registry.testing import check
from registry.toolkit.drawing import turned
from registry.toolkit.photos import Decoder, LoadedPhotos
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.photos import (
    PhotosScene,
    VideoScene,
    stereogs_register_scenes,
    unposed_photos,
)
from stereogs_plugins.scenes.photos.found_cameras import FoundCameras
from stereogs_plugins.scenes.photos.loader import PhotosSettings, _turned_upright
from stereogs_plugins.scenes.photos.photogrammetry import structure_from_motion
from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_name, read_model
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, read_folder
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.scenes.photos.photographs import (
    COUNT,
    SIDEWAYS,
    load,
    pose_errors,
    reconstruction_of,
    with_focal,
    write_pictures,
)


def test_registers_as_photos() -> None:
    assert offered(stereogs_register_scenes) == {"photos": PhotosScene, "video": VideoScene}


def test_cameras_of_the_room_are_found(folder: Path, room: Scene, entry: Path) -> None:
    scene = load(folder, test_every=0)
    assert [view.name for view in scene.train] == [view.name for view in room.train]
    found, truth = ([view.camera for view in s.train] for s in (scene, room))
    rotations, directions = pose_errors(found, truth)
    assert rotations.max() < 0.5
    assert directions.max() < 2
    assert found[0].fx == pytest.approx(truth[0].fx, rel=0.05)
    assert scene.points is not None
    assert len(scene.points) > 100
    assert scene.test == ()


def test_a_photograph_stored_sideways_is_turned(folder: Path, room: Scene, entry: Path) -> None:
    scene = load(folder, test_every=0)
    assert scene.fact("turned_upright") == 1
    view = scene.train[SIDEWAYS]
    assert view.camera.width > view.camera.height
    # Undistorted pictures differ by a crop of a few pixels: compare coarse averages.
    shrink = torch.nn.AdaptiveAvgPool2d((6, 8))
    small = [shrink(v.image.permute(2, 0, 1)) for v in (view, room.train[SIDEWAYS])]
    assert float((small[0] - small[1]).abs().mean()) < 0.03


@pytest.mark.proof
def test_masks_exclude_pixels_from_matching_training_and_points(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    photos = Path(shutil.copytree(folder, tmp_path / "photographs"))
    (photos / "masks").mkdir()
    for index, path in enumerate(sorted(photos.glob("*.jpg"))):
        with Image.open(path) as opened:
            exif, pixels = opened.getexif(), np.array(opened)
        kept = np.full(pixels.shape[:2], 255, np.uint8)
        # The same in each photograph, as a stain on the lens: matched, it would say that nothing moved.
        stain = np.random.default_rng(0).random((90, 90, 1)) * [255, 0, 255]
        pixels[100:190, 100:190], kept[100:190, 100:190] = stain, 0
        Image.fromarray(pixels).save(path, quality=97, exif=exif)
        as_shown = np.rot90(kept, -1).copy() if index == SIDEWAYS else kept
        Image.fromarray(as_shown).save(photos / "masks" / f"{path.name}.png")
    scene = load(photos)
    assert len(scene.train) == COUNT
    for view in scene.train:
        red, green, blue = view.for_training().image.unbind(2)
        assert not ((red > green + 0.4) & (blue > green + 0.4)).any()
        assert view.weights is not None
        assert 0.88 < view.weights.mean() < 0.94
    (entry,) = (tmp_path / "cache" / "cameras").iterdir()
    model = read_model(entry / "piece_0")
    for image in model.images.values():
        x, y = np.array([point.xy for point in image.points2D if point.has_point3D()]).T
        if image.name != image_name(SIDEWAYS):
            assert not ((abs(x - 145) < 43) & (abs(y - 145) < 43)).any()


def test_masks_without_photographs_are_named(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "masks").mkdir()
    masks = [tmp_path / name for name in ("masks/0.png", "1_mask.png", "masks/other.png")]
    for path in masks:
        Image.new("L", (40, 30), 255).save(path)
    found = read_folder(tmp_path)
    assert [photo.mask for photo in found.photos] == [*masks[:2], None]
    ((path, reason),) = found.left_out
    assert (path.name, reason) == ("other.png", "a mask without a photograph of this name")
    (tmp_path / "all").mkdir()
    shutil.move(tmp_path / "masks", tmp_path / "all")
    write_pictures(tmp_path / "all" / "masks", 3)
    assert len(read_folder(tmp_path / "all").photos) > 2  # photographs of masks


@pytest.mark.parametrize("ignored", [False, True])
def test_focal_lengths_in_exif_that_do_not_fit_are_named(
    folder: Path,
    entry: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    ignored: bool,
) -> None:
    def find(self: PhotosScene, photos: list[UnposedPhoto]) -> FoundCameras:
        found = original(self, photos)
        return found._replace(reconstruction=replace(found.reconstruction, ignores_exif=ignored))

    original, files = PhotosScene._find_cameras, read_folder(folder)
    photos = [replace(photo, focal=3.0) for photo in files.photos]
    monkeypatch.setattr(
        unposed_photos, "read_folder", lambda _, **__: files._replace(photos=photos)
    )
    monkeypatch.setattr(PhotosScene, "_find_cameras", find)
    scene = load(folder)
    assert scene.fact("focal_lengths_by_exif") == (0 if ignored else COUNT)
    assert ("the focal lengths in EXIF are ignored" in caplog.text) == ignored


def test_all_photographs_train_unless_some_are_held_out(
    folder: Path, entry: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        scene = load(folder)
    assert scene.test == ()
    assert "hold" not in caplog.text
    # Of eight or more, runs of older versions held out every eighth; their pipelines say null.
    given = {"path": folder}
    train, test, _ = PhotosSettings.model_validate(given).split(9, "")
    assert (train, test) == ([*range(9)], [])
    older = PhotosSettings.model_validate({**given, "test_every": None})
    assert older.split(9, "")[1] == [0, 8]


def test_a_photograph_on_its_side_is_turned_without_exif(
    room: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    weights = torch.rand(room.train[1].image.shape[:2])
    sideways = replace(
        room.train[1],
        weights=torch.rot90(weights, 1),
        image=torch.rot90(room.train[1].image, 1),
        camera=turned(room.train[1].camera, 1),
    )
    views = [room.train[0], sideways, *room.train[2:]]
    loaded, names = _turned_upright(LoadedPhotos([], views, Decoder(), [0, 1, 2, 3, 4], []))
    assert names == [sideways.name]
    assert f"turned as the others are: {sideways.name}" in caplog.text
    assert torch.equal(loaded.views[1].image, room.train[1].image)
    assert loaded.views[1].weights is not None
    assert torch.equal(loaded.views[1].weights, weights)
    assert torch.allclose(
        loaded.views[1].camera.world_to_camera, room.train[1].camera.world_to_camera
    )
    assert _turned_upright(loaded) == (loaded, [])


def test_the_split_and_its_points(folder: Path, entry: Path) -> None:
    scene = load(folder, test_every=3)
    assert (scene.fact("train_photographs"), scene.fact("test_photographs")) == ((1, 2, 4), (0, 3))
    fewer = load(folder, test_every=3, train_views=2)
    assert fewer.fact("train_photographs") == (1, 4)
    assert scene.points is not None
    assert fewer.points is not None
    assert 0 < len(fewer.points) < len(scene.points)
    assert fewer.bounds[0] < fewer.bounds[1]
    with pytest.raises(SceneError, match="only 3 photographs are not test views"):
        load(folder, test_every=3, train_views=4)


def test_two_photographs_need_a_known_focal_length(
    folder: Path, room: Scene, tmp_path: Path
) -> None:
    lens = room.train[0].camera
    exif = with_focal(round(lens.fx / math.hypot(lens.width, lens.height) * 43.27))
    for view in room.train[:2]:
        with Image.open(folder / f"{view.name}.jpg") as opened:
            opened.save(tmp_path / f"{view.name}.jpg", quality=97, exif=exif)
    scene = load(tmp_path)
    assert len(scene.train) == 2
    turns = [
        first.camera.world_to_camera[:3, :3] @ second.camera.world_to_camera[:3, :3].T
        for first, second in (scene.train, room.train[:2])
    ]
    cosine = (torch.trace(turns[0] @ turns[1].T) - 1) / 2
    assert math.degrees(math.acos(min(1, float(cosine)))) < 2
    for file in tmp_path.iterdir():
        Image.open(file).save(file, quality=97, exif=Image.Exif())
    with pytest.raises(SceneError, match="or two with a focal length in EXIF"):
        load(tmp_path)


def test_altered_photographs_are_named(
    folder: Path, entry: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    found = reconstruction_of(entry)
    found.pieces[0] = found.pieces[0]._replace(altered=(1, 3))
    load(folder)
    assert "cropped" not in caplog.text
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.setattr(structure_from_motion, "reconstruct", lambda *_: found)
    load(folder)
    assert "cropped or zoomed, as it seems: train_01.jpg, train_03.jpg" in caplog.text


def test_few_photographs_are_reduced_and_all_train(folder: Path, entry: Path) -> None:
    scene = load(folder, max_size=120)
    assert (len(scene.train), len(scene.test)) == (5, 0)
    # Cropping by undistortion changes the size a little.
    assert max(scene.train[0].image.shape[:2]) <= 130
    assert "resized from 360x270 to 120x90" in str(scene.fact("changed"))


def test_transparent_pictures_are_laid_on_the_background(
    folder: Path,
    entry: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.setattr(structure_from_motion, "reconstruct", lambda *_: reconstruction_of(entry))
    copy = shutil.copytree(folder, tmp_path / "copy")
    for path, alpha in (("train_01", 0), ("train_03", 255)):
        with Image.open(copy / f"{path}.jpg") as file:
            picture = file.convert("RGBA")
        picture.paste((255, 0, 0, alpha), (0, 0, 5, 5))
        picture.save(copy / f"{path}.png")
        (copy / f"{path}.jpg").unlink()
    assert [photo.name for photo in read_folder(copy).photos if photo.transparent] == [
        "train_01.png"
    ]
    scene = load(copy, test_every=0)
    assert "in 1 of 5 pictures, train_01.png first, are laid on" in caplog.text
    assert "background (0 0 0)" in caplog.text
    assert float(scene.train[1].image[:3, :3].max()) < 0.2
    assert scene.background == (0, 0, 0)


def test_the_contract(folder: Path, entry: Path) -> None:
    check(PhotosScene, path=folder)


@pytest.mark.parametrize(
    ("file", "recognized"),
    [
        (".hidden", True),
        ("Thumbs.db", True),
        ("notes.txt", True),
        ("IMG_1.DNG", True),
        ("database.db", True),
        ("hloc/features.h5", True),
        ("sparse/project.ini", True),
        ("scene.rcproj", True),
        ("transforms.json", False),
        ("sparse/0/cameras.bin", False),
        ("cameras.txt", False),
    ],
)
def test_folders_that_are_recognized(file: str, recognized: bool, tmp_path: Path) -> None:
    assert not PhotosScene.recognizes(tmp_path)
    write_pictures(tmp_path, 1)
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).touch()
    assert PhotosScene.recognizes(tmp_path) is recognized


def test_a_folder_with_a_link_to_a_folder_is_not_recognized(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1)
    assert PhotosScene.recognizes(tmp_path)
    (tmp_path / "sparse").symlink_to(tmp_path.parent)
    assert not PhotosScene.recognizes(tmp_path)


@pytest.mark.proof
def test_the_published_cameras_of_the_fern(tmp_path: Path) -> None:
    """Eight of the twenty pictures; with all of them rotations are off by 0.33 degrees at most."""
    data = data_folder("llff_fern")
    published = build(LLFFScene, path=data, train_views=None).load()
    cameras = {view.name: view.camera for view in (*published.train, *published.test)}
    for path in sorted((data / "images_8").iterdir())[:8]:
        shutil.copy(path, tmp_path)
    scene = load(tmp_path, test_every=0)
    rotations, directions = pose_errors(
        [view.camera for view in scene.train], [cameras[view.name] for view in scene.train]
    )
    assert len(rotations) == 8
    assert rotations.max() < 0.75
    assert directions.max() < 2
