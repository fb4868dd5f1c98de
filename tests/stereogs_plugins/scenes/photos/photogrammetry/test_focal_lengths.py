"""Focal lengths that are implausible, or that EXIF has wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image, ImageOps

from registry import Scene
from stereogs_plugins.scenes.photos.photogrammetry.colmap import (
    image_name,
    lens_of,
    read_model,
    relative_focal,
    set_focal,
)
from stereogs_plugins.scenes.photos.photogrammetry.focal_lengths import is_plausible
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.data import data_folder
from tests.stereogs_plugins.scenes.photos.photographs import (
    load,
    pose_errors,
    reconstruct,
    with_focal,
)

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model


@pytest.mark.parametrize(
    ("focal", "by_exif", "plausible"),
    [
        (0.8, None, True),
        (0.4, None, False),
        (5.0, None, False),
        (5.0, 6.7, True),
        (5.0, 0.7, False),
    ],
)
def test_plausible_focal_lengths(
    synthetic: tuple[Path, Model], focal: float, by_exif: float | None, plausible: bool
) -> None:
    _, model = synthetic
    for index, image in enumerate(model.reg_image_ids()):
        model.image(image).name = image_name(index)
    (lens,) = model.cameras.values()
    set_focal(lens, focal * max(lens.width, lens.height))
    assert is_plausible(model, [by_exif] * 4) is plausible


@pytest.mark.proof
@pytest.mark.parametrize("wrong", [range(5), [2]])
def test_wrong_focal_lengths_in_exif_are_ignored(
    folder: Path,
    room: Scene,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    wrong: Sequence[int],
) -> None:
    for index, view in enumerate(room.train):
        name = f"{view.name}.jpg"
        with Image.open(folder / name) as opened:
            upright = ImageOps.exif_transpose(opened)
        exif = with_focal(400) if index in wrong else b""
        upright.save(tmp_path / name, quality=97, exif=exif)
    scene = load(tmp_path)
    found, truth = ([view.camera for view in s.train] for s in (scene, room))
    assert pose_errors(found, truth)[0].max() < 0.5
    assert f"{room.train[wrong[0]].name}.jpg has 400 mm" in caplog.text
    assert scene.fact("focal_lengths_by_exif") == 0


@pytest.mark.proof
@pytest.mark.parametrize(
    ("scene", "pictures", "wrong", "right"),
    [("llff_fortress", "images_8", 6.7, 0.84), ("mview_temple", "images", 0.71, 2.38)],
)
def test_wrong_focal_lengths_with_few_photographs_are_ignored(
    scene: str, pictures: str, wrong: float, right: float, tmp_path: Path
) -> None:
    """Three neighbours: fixed lenses 8 times as long fit, or a free lens ends half as long."""
    photos = read_folder(data_folder(scene) / pictures).photos
    first = len(photos) // 3
    photos = [replace(photo, focal=wrong) for photo in photos[first : first + 3]]
    found = reconstruct(photos, tmp_path)
    assert found.ignores_exif
    assert found.pieces[0].members == [0, 1, 2]
    model = read_model(found.pieces[0].folder)
    focal = relative_focal(lens_of(model, min(model.reg_image_ids())))
    assert 0.9 < focal / right < 1.7
