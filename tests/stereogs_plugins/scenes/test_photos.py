from __future__ import annotations

import logging
import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from core_rasterizer import Camera
from registry import Scene, SceneError
from registry.drawing.pictures import to_bytes
from registry.photos import ColmapModel, Decoder
from registry.testing import check
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.photos import (
    PhotosScene,
    stereogs_register_scenes,
    structure_from_motion,
)
from stereogs_plugins.scenes.photos.disconnected import require_one_piece
from stereogs_plugins.scenes.photos.found_cameras import FoundCameras, remembered_cameras
from stereogs_plugins.scenes.photos.mapping import Piece
from stereogs_plugins.scenes.photos.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered

Array = NDArray[np.float64]
COUNT, SIDEWAYS = 5, 2
ORIENTATION, FOCAL_35MM = 0x0112, 0xA405


def load(folder: Path, **settings: object) -> Scene:
    return build(PhotosScene, path=folder, **settings).load()


@pytest.fixture(scope="module")
def room() -> Scene:
    """The procedural room from five places: the truth."""
    return build(
        ProceduralScene, train_views=COUNT, test_views=0, width=360, height=270, points=0
    ).load()


@pytest.fixture(scope="module")
def folder(room: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its photographs, one of them stored sideways, and nothing else."""
    folder = tmp_path_factory.mktemp("photographs")
    for index, view in enumerate(room.train):
        exif = Image.Exif()
        picture = Image.fromarray(to_bytes(view.image))
        if index == SIDEWAYS:
            picture = picture.transpose(Image.Transpose.ROTATE_90)
            exif[ORIENTATION] = 6  # to be turned by 90 degrees clockwise
        picture.save(folder / f"{view.name}.jpg", quality=97, exif=exif)
    return folder


@pytest.fixture(scope="module")
def cache(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that knows the cameras of `folder`."""
    cache = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STEREOGS_CACHE", str(cache))
        load(folder)
    return cache


@pytest.fixture
def cached(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_CACHE", str(cache))
    return cache


def pose_errors(found: list[Camera], truth: list[Camera]) -> tuple[Array, Array]:
    """Degrees, after the similarity that aligns the camera centres best (Umeyama 1991).

    Returns:
        the angle of each rotation, and of the line between each two cameras.
    """
    rotation = [np.stack([c.world_to_camera[:3, :3].numpy().T for c in s]) for s in (found, truth)]
    center = [np.stack([c.center.numpy() for c in s]) for s in (found, truth)]
    center = [positions - positions.mean(axis=0) for positions in center]
    u, _, v = np.linalg.svd(center[1].T @ center[0])
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    residual = np.swapaxes(rotation[1], 1, 2) @ turn @ rotation[0]
    cosines = (np.trace(residual, axis1=1, axis2=2) - 1) / 2
    first, second = np.triu_indices(len(found), 1)
    lines = [p[first] - p[second] for p in (center[0] @ turn.T, center[1])]
    lines = [line / np.linalg.norm(line, axis=1, keepdims=True) for line in lines]
    along = (lines[0] * lines[1]).sum(axis=1)
    rotations, directions = (np.degrees(np.arccos(np.clip(c, -1, 1))) for c in (cosines, along))
    return rotations, directions


NAMES = ("a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg")
MATCHES = {(0, 1): 200, (0, 2): 90, (1, 2): 150, (3, 4): 80, (2, 3): 12, (1, 3): 9}


def reconstruction_of(entry: Path) -> Reconstruction:
    """What an entry of the cache holds, with other matches."""
    return Reconstruction([Piece(entry / "piece_0", [0, 1, 2, 3, 4])], MATCHES, [900] * COUNT)


def test_is_offered_as_photos() -> None:
    assert offered(stereogs_register_scenes) == {"photos": PhotosScene}


def test_cameras_of_the_room_are_found(folder: Path, room: Scene, cached: Path) -> None:
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


def test_a_photograph_stored_sideways_is_turned(folder: Path, room: Scene, cached: Path) -> None:
    scene = load(folder, test_every=0)
    assert scene.fact("turned_upright") == 1
    view = scene.train[SIDEWAYS]
    assert view.camera.width > view.camera.height
    # Undistorted pictures differ by a crop of a few pixels: compare coarse averages.
    shrink = torch.nn.AdaptiveAvgPool2d((6, 8))
    small = [shrink(v.image.permute(2, 0, 1)) for v in (view, room.train[SIDEWAYS])]
    assert float((small[0] - small[1]).abs().mean()) < 0.03


def test_the_split_and_its_points(folder: Path, cached: Path) -> None:
    scene = load(folder, test_every=3)
    assert (scene.fact("train_photographs"), scene.fact("test_photographs")) == ((1, 2, 4), (0, 3))
    fewer = load(folder, test_every=3, train_views=2)
    assert fewer.fact("train_photographs") == (1, 4)
    assert scene.points is not None
    assert fewer.points is not None
    assert 0 < len(fewer.points) < len(scene.points)
    assert fewer.bounds[0] < fewer.bounds[1]
    with pytest.raises(SceneError, match="only 3 are not test views"):
        load(folder, test_every=3, train_views=4)


def test_photographs_are_reduced(folder: Path, cached: Path) -> None:
    view = load(folder, max_size=120).train[0]
    assert max(view.image.shape[:2]) <= 130  # cropping by undistortion changes it a little
    assert "resized from 360x270 to 120x90" in str(load(folder, max_size=120).fact("changed"))


def test_cameras_are_found_once(
    folder: Path, cached: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    load(copy)
    assert caplog.messages == []


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "checksum"])
def test_damaged_cameras_are_found_anew(
    damage: str,
    folder: Path,
    cached: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (whole,) = cached.glob("cameras/*")
    photos = read_folder(folder)
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked: list[Path] = []

    def compute(empty: Path) -> Reconstruction:
        asked.append(empty)
        return reconstruction_of(whole)

    before = remembered_cameras(photos, "treatment", compute)
    (kept,) = tmp_path.glob("cameras/*")
    images = kept / "piece_0" / "images.bin"
    content = bytearray(images.read_bytes())
    if damage == "flip":
        content[20] ^= 1
        images.write_bytes(content)
    elif damage == "cut":
        images.write_bytes(content[:100])
    elif damage == "missing":
        images.unlink()
    else:
        (kept / "checksum.txt").write_bytes(b"\xff")
    after = remembered_cameras(photos, "treatment", compute)
    assert "damaged" in caplog.text
    assert before.model is not None
    assert after.model is not None
    assert after.model.images == before.model.images
    again = remembered_cameras(photos, "treatment", compute)
    assert again.model is not None
    assert again.model.points == before.model.points
    assert again.reconstruction.matches == before.reconstruction.matches == MATCHES
    assert len(asked) == 2


def test_other_photographs_or_settings_are_other_cameras(
    folder: Path, cached: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = read_folder(folder)
    (whole,) = cached.glob("cameras/*")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked: list[Path] = []

    def compute(empty: Path) -> Reconstruction:
        asked.append(empty)
        return reconstruction_of(whole)

    for treatment, chosen in (("a", photos), ("a", photos), ("b", photos), ("a", photos[1:])):
        remembered_cameras(chosen, treatment, compute)
    assert len(asked) == 3


@pytest.mark.proof
def test_a_photograph_of_something_else_is_named(folder: Path, tmp_path: Path) -> None:
    from skimage import data

    copy = shutil.copytree(folder, tmp_path / "mixed")
    (copy / "train_01.jpg").unlink()
    Image.fromarray(data.coffee()).resize((360, 270)).save(copy / "coffee.png")
    with pytest.raises(SceneError) as caught:
        load(copy)
    assert "the cameras of 4 of 5 photographs fit together" in caught.value.what
    assert "group 2: coffee.png" in caught.value.what
    assert "coffee.png" in caught.value.fix


def test_photographs_that_share_nothing(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    for index in range(3):
        pixels = generator.integers(0, 256, (120, 160, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
    with pytest.raises(SceneError, match="no two of the 3 photographs overlap"):
        load(tmp_path)


def test_the_contract(folder: Path, cached: Path) -> None:
    check(PhotosScene, path=folder)


class TestExplanation:
    def explain(
        self,
        pieces: list[list[int]],
        features: tuple[int, ...] = (900,) * len(NAMES),
        matches: dict[tuple[int, int], int] = MATCHES,
    ) -> SceneError:
        found = Reconstruction([Piece(Path(), p) for p in pieces], matches, list(features))
        model = ColmapModel({}, [], [], Path()) if pieces else None
        with pytest.raises(SceneError) as caught:
            require_one_piece(FoundCameras(found, model), NAMES, "folder")
        return caught.value

    def test_groups_matches_and_the_picture_between(self) -> None:
        error = self.explain([[0, 1, 2], [3, 4]])
        assert "3 of 5 photographs" in error.what
        assert "group 1: a.jpg, b.jpg, c.jpg" in error.what
        assert "group 2: d.jpg, e.jpg" in error.what
        assert "    c.jpg  b.jpg 150, a.jpg 90, d.jpg 12" in error.what.splitlines()
        assert "between d.jpg and c.jpg, which share only 12 matches" in error.fix
        assert error.what.splitlines()[-1] == "  matched by SIFT"

    def test_a_photograph_that_two_pieces_have_is_counted_once(self) -> None:
        assert "group 2: d.jpg, e.jpg" in self.explain([[0, 1, 2], [2, 3, 4]]).what

    def test_photographs_without_a_piece_are_grouped_by_matches(self) -> None:
        assert "group 2: d.jpg, e.jpg" in self.explain([[0, 1, 2]]).what

    def test_photographs_without_any_match(self) -> None:
        error = self.explain([[0, 1, 2]], matches={(0, 1): 200, (1, 2): 150})
        assert "group 3: e.jpg" in error.what
        assert "    e.jpg  none" in error.what.splitlines()
        assert "no overlap between e.jpg and the rest" in error.fix

    def test_a_blurred_photograph(self) -> None:
        error = self.explain([[0, 1, 2, 3]], (900, 900, 900, 900, 17))
        assert "take e.jpg again: 17 details" in error.fix

    def test_many_matches_are_not_called_few(self) -> None:
        error = self.explain([[0, 1, 2, 3]], matches=MATCHES | {(3, 4): 1660})
        assert "e.jpg shares 1,660 matches with d.jpg" in error.fix
        assert "only" not in error.fix

    def test_nothing_at_all(self) -> None:
        error = self.explain([], matches={(0, 1): 12})
        assert "no two of the 5 photographs overlap" in error.what
        assert "group" not in error.what

    def test_matches_without_depth(self) -> None:
        error = self.explain([], matches={(0, 1): 1660})
        assert "share up to 1,660 matches" in error.what
        assert "overlap" not in str(error)
        assert "step to the side" in error.fix

    def test_one_piece_is_accepted(self) -> None:
        found = Reconstruction([Piece(Path(), [0, 1, 2, 3, 4])], MATCHES, [900] * 5)
        model = ColmapModel({}, [], [], Path())
        assert require_one_piece(FoundCameras(found, model), NAMES, "folder") is model


def write_pictures(folder: Path, count: int) -> None:
    for index in range(count):
        Image.new("RGB", (40, 30), (60 * index, 0, 0)).save(folder / f"{index}.jpg")


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photographs(count: int, tmp_path: Path) -> None:
    write_pictures(tmp_path, count)
    with pytest.raises(SceneError, match=f"at least 3 photographs; here are {count}"):
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


def test_a_file_that_is_no_picture(tmp_path: Path) -> None:
    write_pictures(tmp_path, 3)
    (tmp_path / "1.jpg").write_text("hello")
    with pytest.raises(SceneError, match="cannot be read"):
        load(tmp_path)


def test_equal_pictures_are_told_all_at_once(tmp_path: Path) -> None:
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
    assert caught.value.fix == "take out of the folder: 2 (1).jpg, copy.jpg, in/1.jpg"


def test_pictures_of_a_kind_that_is_not_read_are_not_left_out(tmp_path: Path) -> None:
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


def test_transparent_pictures_are_laid_on_the_background(
    folder: Path,
    cached: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (whole,) = cached.glob("cameras/*")
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.setattr(structure_from_motion, "reconstruct", lambda *_: reconstruction_of(whole))
    copy = shutil.copytree(folder, tmp_path / "copy")
    for path, alpha in (("train_01", 0), ("train_03", 255)):
        with Image.open(copy / f"{path}.jpg") as file:
            picture = file.convert("RGBA")
        picture.paste((255, 0, 0, alpha), (0, 0, 5, 5))
        picture.save(copy / f"{path}.png")
        (copy / f"{path}.jpg").unlink()
    assert [photo.name for photo in read_folder(copy) if photo.transparent] == ["train_01.png"]
    scene = load(copy, test_every=0)
    assert "in 1 of 5 pictures, train_01.png first, are laid on" in caplog.text
    assert "background (0 0 0)" in caplog.text
    assert float(scene.train[1].image[:3, :3].max()) < 0.2
    assert scene.background == (0, 0, 0)


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


def test_folders_that_are_recognized(tmp_path: Path) -> None:
    assert not PhotosScene.recognizes(tmp_path)
    write_pictures(tmp_path, 1)
    (tmp_path / ".hidden").touch()
    assert PhotosScene.recognizes(tmp_path)
    (tmp_path / "Thumbs.db").touch()
    assert PhotosScene.recognizes(tmp_path)
    (tmp_path / "cameras.txt").touch()
    assert not PhotosScene.recognizes(tmp_path)
    (tmp_path / "cameras.txt").unlink()
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
