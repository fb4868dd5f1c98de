"""Photographs from one position and of one flat surface are told apart, in the loader's error too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import Scene, SceneError
from registry.toolkit.drawing import to_bytes
from stereogs_plugins.scenes.photos.photogrammetry import structure_from_motion
from stereogs_plugins.scenes.photos.photogrammetry.matching import matchings
from stereogs_plugins.scenes.photos.photogrammetry.thresholds import MIN_DEVIATION
from stereogs_plugins.scenes.photos.photogrammetry.two_view import rotation_error
from tests.data import data_folder
from tests.stereogs_plugins.scenes.photos.photographs import Array, load

SIZE = (360, 270)
LENS = np.array([[300.0, 0, 180], [0, 300, 135], [0, 0, 1]])


def rotation(degrees: float) -> Array:
    """About the vertical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def homography(degrees: float, shift: tuple[float, float, float] = (0, 0, 0)) -> Array:
    """Of the plane z = 1 after a turn and a shift of the camera."""
    motion = rotation(degrees) + np.outer(shift, [0, 0, 1])
    result: Array = LENS @ motion @ np.linalg.inv(LENS)
    return result


def test_rotation_and_shift_are_told_apart() -> None:
    for degrees in (2, 10, 25):
        assert rotation_error(3 * homography(degrees), SIZE) < MIN_DEVIATION / 2
        assert rotation_error(homography(degrees, (0.3, 0, 0)), SIZE) > MIN_DEVIATION


def write(scene: Scene, folder: Path, views: list[Array]) -> None:
    """Write one photograph as it looks through several homographies."""
    picture = Image.fromarray(to_bytes(scene.train[0].image))
    for index, view in enumerate(views):
        rows = np.linalg.inv(view)
        seen = picture.transform(
            SIZE,
            Image.Transform.PERSPECTIVE,
            (rows / rows[2, 2]).flatten()[:8].tolist(),
            Image.Resampling.BICUBIC,
        )
        seen.save(folder / f"{index}.png")


@pytest.mark.proof
def test_photographs_from_one_position(
    room: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        structure_from_motion, "matchings", lambda *some: matchings(*some)[:1]
    )  # SIFT
    write(room, tmp_path, [homography(degrees) for degrees in (0, 5, 10)])
    with pytest.raises(SceneError) as caught:
        load(tmp_path)
    assert "they were taken from one position" in caught.value.what
    assert "do not turn on the spot" in caught.value.fix


@pytest.mark.proof
def test_photographs_of_a_flat_surface(room: Scene, tmp_path: Path) -> None:
    shifts = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.1, 0.1, 0.1)]
    write(room, tmp_path, [homography(40 * x, (x, y, z)) for x, y, z in shifts])
    with pytest.raises(SceneError) as caught:
        load(tmp_path)
    assert "one flat surface" in caught.value.what
    assert "in front of the surface" in caught.value.fix


@pytest.mark.proof
def test_neighbouring_frames_of_a_video_have_depth(tmp_path: Path) -> None:
    """Three of mip360_bonsai: a homography explains over 80 % of their matches."""
    files = sorted((data_folder("mip360_bonsai") / "images_800").iterdir())
    for file in files[len(files) // 3 :][:3]:
        (tmp_path / file.name).symlink_to(file)
    assert len(load(tmp_path).train) == 3
