"""The dense check separates right from wrong cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image, ImageOps

from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_name, index_of
from stereogs_plugins.scenes.photos.photogrammetry.dense.check import DenseCheck
from stereogs_plugins.scenes.photos.photogrammetry.thresholds import MIN_ADVANTAGE
from tests.stereogs_plugins.scenes.photos.photographs import turn

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model

pytestmark = pytest.mark.proof


def first_two(model: Model) -> list[int]:
    """Image ids of the first two photographs."""
    return sorted(model.reg_image_ids(), key=lambda k: index_of(model, k))[:2]


def test_right_cameras_are_confirmed(model: Model, images: Path) -> None:
    check = DenseCheck(images)
    assert check.confirms(model, *first_two(model))
    assert check.advantage(model, *first_two(model)) > 1.5 * MIN_ADVANTAGE


def test_a_turned_camera_is_not(model: Model, images: Path) -> None:
    turn(model, first_two(model)[1], (0, 0, 1), 20)
    check = DenseCheck(images)
    assert not check.confirms(model, *first_two(model))
    assert check.rejected == {(0, 1)}


def test_another_picture_is_not(model: Model, images: Path, tmp_path: Path) -> None:
    """As with opposite sides of a symmetric object: cameras fit together, the pictures do not."""
    for index in (0, 1):
        with Image.open(images / image_name(index)) as opened:
            picture = ImageOps.flip(opened) if index else opened
            picture.save(tmp_path / image_name(index))
    assert not DenseCheck(tmp_path).confirms(model, *first_two(model))


def test_cameras_at_one_place_are_not(model: Model, images: Path) -> None:
    frames = [model.frame(model.image(k).frame_id) for k in first_two(model)]
    frames[1].rig_from_world = frames[0].rig_from_world
    assert DenseCheck(images).advantage(model, *first_two(model)) == 0
