"""Cameras are cached, and estimated again if the cache is damaged."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from PIL import Image

from stereogs_plugins.scenes.photos import PhotosScene
from stereogs_plugins.scenes.photos.found_cameras import FoundCameras, remembered_cameras
from stereogs_plugins.scenes.photos.loader import treatment_of
from stereogs_plugins.scenes.photos.photogrammetry import learned_matches
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, read_folder
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.photos.photographs import MATCHES, load, reconstruction_of

Find = Callable[[str, Sequence[UnposedPhoto]], FoundCameras]


def test_cameras_are_estimated_once(
    folder: Path, entry: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    load(shutil.copytree(folder, tmp_path / "elsewhere"))
    assert "finding the cameras" not in caplog.text
    assert [*entry.parent.iterdir()] == [entry]


def test_short_time_matches_smaller_photographs_unless_their_cameras_are_known(
    folder: Path, find: tuple[Find, list[Path]], tmp_path: Path
) -> None:
    large = tmp_path / "large"
    large.mkdir()
    for file in folder.iterdir():
        with Image.open(file) as picture:
            picture.resize((1280, 960)).save(large / file.name)
    asked = build(PhotosScene, path=large).settings
    taken = [PhotosScene.within(asked, seconds).matching_size for seconds in (0, 20, 33, 44)]
    assert taken == [600, 600, 945, 1200]
    small = build(PhotosScene, path=folder).settings
    assert PhotosScene.within(small, 0) is small, "of 360 pixels"
    with_prior = asked.model_copy(update={"cameras": "a_prior"})
    assert PhotosScene.within(with_prior, 0) is with_prior
    missing = build(PhotosScene, path=tmp_path / "missing").settings
    assert PhotosScene.within(missing, 0) is missing
    find[0](treatment_of(asked), read_folder(large).photos)
    assert PhotosScene.within(asked, 0) is asked


def test_each_conversion_of_the_networks_has_its_own_cameras(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = build(PhotosScene, path=folder).settings
    asked = set()
    for names in (None, ("finder.onnx", "matcher.onnx"), ("aliked.onnx", "lightglue.onnx")):
        files = names and tuple(map(Path, names))
        monkeypatch.setattr(learned_matches, "known_files", lambda files=files: files)
        asked.add(treatment_of(settings))
    assert len(asked) == 3


@pytest.fixture
def find(entry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Find, list[Path]]:
    """Cameras of photographs with an empty cache, and the folders of those that were estimated."""
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    estimated: list[Path] = []

    def compute(empty: Path) -> Reconstruction:
        estimated.append(empty)
        return reconstruction_of(entry)

    return lambda treatment, photos: remembered_cameras(
        photos, lambda: treatment, compute
    ), estimated


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "checksum"])
def test_damaged_cameras_are_estimated_again(
    damage: str,
    folder: Path,
    find: tuple[Find, list[Path]],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (found, estimated), photos = find, read_folder(folder).photos
    before = found("treatment", photos)
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
    after = found("treatment", photos)
    assert "damaged" in caplog.text
    assert before.model is not None
    assert after.model is not None
    assert after.model.images == before.model.images
    again = found("treatment", photos)
    assert again.model is not None
    assert again.model.points == before.model.points
    assert again.reconstruction.matches == before.reconstruction.matches == MATCHES
    assert len(estimated) == 2


def test_other_photographs_or_settings_are_other_cameras(
    folder: Path, find: tuple[Find, list[Path]]
) -> None:
    (found, estimated), photos = find, read_folder(folder).photos
    for treatment, chosen in (("a", photos), ("a", photos), ("b", photos), ("a", photos[1:])):
        found(treatment, chosen)
    assert len(estimated) == 3
