"""Mapping methods, and models that the matches contradict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from registry.toolkit.photos import Decoder, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos.mapping import (
    LEARNED_TRUST,
    SIFT_TRUST,
    Piece,
    Trust,
    connected,
    drop_unsupported,
    is_contradicted,
    is_plausible,
    of_one_scale,
)
from stereogs_plugins.scenes.photos.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import image_name, read_folder
from tests.data import data_folder


@pytest.fixture
def made(tmp_path: Path) -> tuple[Any, Path, Any]:
    """pycolmap, a database of four photographs with exact matches, and their model."""
    colmap = import_pycolmap(3)
    colmap.set_random_seed(0)
    options = colmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 4
    options.num_points3D = 60
    path = tmp_path / "matches.db"
    with colmap.Database.open(path) as database:
        return colmap, path, colmap.synthesize_dataset(options, database)


def turn(colmap: Any, model: Any, count: int) -> list[int]:
    """Turn the cameras of some photographs by 23 degrees; return their ids."""
    ids = sorted(model.reg_image_ids())[:count]
    for number, image in enumerate(ids, start=1):
        frame = model.frame(model.image(image).frame_id)
        half = 0.2 * number
        turned = colmap.Rotation3d(np.array([0.0, 0.0, np.sin(half), np.cos(half)]))
        moved = frame.rig_from_world
        frame.rig_from_world = colmap.Rigid3d(turned * moved.rotation, moved.translation)
    return ids


def always(model: Any, first: int, second: int) -> bool:
    return True


def never(model: Any, first: int, second: int) -> bool:
    return False


def test_a_supported_model_keeps_its_photographs(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    assert drop_unsupported(colmap, path, model, SIFT_TRUST, never)
    assert model.num_reg_images() == 4


def test_pictures_decide_where_matches_do_not_suffice(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    seen = []

    def same(model: Any, first: int, second: int) -> bool:
        seen.append((first, second))
        return 4 not in (first, second)

    copy = type(model)(model)
    assert drop_unsupported(colmap, path, model, LEARNED_TRUST, same)
    assert sorted(model.reg_image_ids()) == [1, 2, 3]
    assert len(seen) == 3, "two links, and one attempt to add the fourth"
    assert not drop_unsupported(colmap, path, copy, LEARNED_TRUST, never)


def test_a_wrong_camera_is_removed(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    (wrong,) = turn(colmap, model, 1)
    assert drop_unsupported(colmap, path, model, SIFT_TRUST, never)
    assert wrong not in model.reg_image_ids()
    assert model.num_reg_images() == 3


def test_a_wrong_model_is_discarded(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    turn(colmap, model, 4)
    assert not drop_unsupported(colmap, path, model, SIFT_TRUST, never)


def test_a_pair_contradicts_a_model(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    assert not is_contradicted(colmap, path, model)
    turn(colmap, model, 1)
    assert is_contradicted(colmap, path, model)


def test_a_pair_without_a_third_photograph_needs_more_matches(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    turn(colmap, model, 2)
    copies = [type(model)(model) for _ in range(2)]
    assert drop_unsupported(colmap, path, model, Trust(15, 15), never)
    assert model.num_reg_images() == 2
    assert not drop_unsupported(colmap, path, copies[0], Trust(15, 1000), never)
    assert drop_unsupported(colmap, path, copies[1], Trust(15, 1000), always)


def test_parts_without_common_points_have_no_common_scale(made: tuple[Any, Path, Any]) -> None:
    _, _, model = made
    images = sorted(model.reg_image_ids())
    links = np.zeros((4, 4), dtype=bool)
    for pair in ((0, 1), (0, 2), (1, 2), (2, 3)):
        links[pair] = links[pair[::-1]] = True
    assert of_one_scale(model, images, links) == [0, 1, 2, 3]
    for key in sorted(model.point3D_ids()):
        removed = images[:2] if key % 2 else images[3:]
        seen = [(e.image_id, e.point2D_idx) for e in model.point3D(key).track.elements]
        for image, place in seen:
            if image in removed:
                model.delete_observation(image, place)
    assert model.num_points3D() > 30
    assert of_one_scale(model, images, links) == [0, 1, 2]
    links[1, 3] = links[3, 1] = True
    assert of_one_scale(model, images, links) == [0, 1, 2, 3]


def test_connected_groups() -> None:
    links = np.zeros((5, 5), dtype=int)
    links[1, 4] = links[0, 3] = links[3, 2] = 7
    assert connected(links) == [[0, 2, 3], [1, 4]]


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
    made: tuple[Any, Path, Any], focal: float, by_exif: float | None, plausible: bool
) -> None:
    _, _, model = made
    for index, image in enumerate(model.reg_image_ids()):
        model.image(image).name = image_name(index)
    (lens,) = model.cameras.values()
    lens.params = [focal * max(lens.width, lens.height), *lens.params[1:]]
    assert is_plausible(model, [by_exif] * 4) is plausible


def place(scene: str, numbers: tuple[int, ...], folder: Path, cropped: int | None = None) -> Piece:
    """The piece of some photographs, one of which lacks its right quarter."""
    every = sorted((data_folder(scene) / "images_8").iterdir())
    (folder / "in").mkdir()
    for number in numbers:
        with Image.open(every[number]) as opened:
            width = opened.width * 3 // 4 if number == cropped else opened.width
            opened.crop((0, 0, width, opened.height)).save(folder / "in" / every[number].name)
    (folder / "out").mkdir()
    decoder = Decoder(longest_side(1200), "box", upright=True)
    found = reconstruct(read_folder(folder / "in").photos, decoder, True, folder / "out")
    assert found.tried == ("SIFT",)
    return found.pieces[0]


def test_forward_facing_pictures_are_placed(tmp_path: Path) -> None:
    """Three of llff_flower: no pair of them is 16 degrees apart, COLMAP's own minimum."""
    piece = place("llff_flower", (0, 16, 33), tmp_path)
    assert piece.members == [0, 1, 2]
    assert piece.folder.parent.name == "incremental_2"


def test_a_lens_without_perspective_is_kept(tmp_path: Path) -> None:
    """Free focal lengths become more than four times the longer side."""
    piece = place("llff_fortress", (9, 11, 13), tmp_path, cropped=11)
    assert piece.members == [0, 1, 2]
    assert piece.folder.parent.name == "fixed_lens_2"
    assert not piece.focal_is_known
    assert is_plausible(import_pycolmap(3).Reconstruction(piece.folder), [None] * 3)
