"""The dense check separates right from wrong cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from registry.toolkit.photos import import_pycolmap
from stereogs_plugins.scenes.photos.dense.check import MIN_ADVANTAGE, DenseCheck
from stereogs_plugins.scenes.photos.unposed_photos import image_index, image_name


def ids(model: Any) -> list[int]:
    """Image ids in the order of the photographs."""
    return sorted(model.reg_image_ids(), key=lambda k: image_index(model.image(k).name))


def test_right_cameras_are_confirmed(model: Any, images: Path) -> None:
    check = DenseCheck(images)
    first, second, *_ = ids(model)
    assert check.confirms(model, first, second)
    assert check.advantage(model, first, second) > 1.5 * MIN_ADVANTAGE


def test_a_turned_camera_is_not(model: Any, images: Path) -> None:
    first, second, *_ = ids(model)
    frame = model.frame(model.image(second).frame_id)
    half = np.radians(20) / 2
    turn = import_pycolmap(3).Rotation3d(np.array([0.0, 0.0, np.sin(half), np.cos(half)]))
    pose = frame.rig_from_world
    frame.rig_from_world = type(pose)(turn * pose.rotation, turn * pose.translation)
    assert not DenseCheck(images).confirms(model, first, second)


def test_another_picture_is_not(model: Any, images: Path, tmp_path: Path) -> None:
    """As with opposite sides of a symmetric object: cameras fit together, the pictures do not."""
    first, second, *_ = ids(model)
    for index in (0, 1):
        with Image.open(images / image_name(index)) as opened:
            picture = ImageOps.flip(opened) if index else opened
            picture.save(tmp_path / image_name(index))
    assert not DenseCheck(tmp_path).confirms(model, first, second)


def test_cameras_at_one_place_are_not(model: Any, images: Path) -> None:
    first, second, *_ = ids(model)
    frames = [model.frame(model.image(k).frame_id) for k in (first, second)]
    frames[1].rig_from_world = frames[0].rig_from_world
    assert DenseCheck(images).advantage(model, first, second) == 0
