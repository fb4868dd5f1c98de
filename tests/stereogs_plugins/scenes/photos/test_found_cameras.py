"""Cameras are cached, and estimated again if the cache is damaged."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import pytest

from stereogs_plugins.scenes.photos.found_cameras import remembered_cameras
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.stereogs_plugins.scenes.photos.photographs import MATCHES, load, reconstruction_of


def test_cameras_are_estimated_once(
    folder: Path, entry: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    load(copy)
    assert "finding the cameras" not in caplog.text


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "checksum"])
def test_damaged_cameras_are_estimated_again(
    damage: str,
    folder: Path,
    entry: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    photos = read_folder(folder).photos
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked: list[Path] = []

    def compute(empty: Path) -> Reconstruction:
        asked.append(empty)
        return reconstruction_of(entry)

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
    folder: Path, entry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = read_folder(folder).photos
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked: list[Path] = []

    def compute(empty: Path) -> Reconstruction:
        asked.append(empty)
        return reconstruction_of(entry)

    for treatment, chosen in (("a", photos), ("a", photos), ("b", photos), ("a", photos[1:])):
        remembered_cameras(chosen, treatment, compute)
    assert len(asked) == 3
