"""Mapping methods, and models that the matches contradict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from registry.toolkit.photos import Decoder, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos.mapping import (
    LEARNED_TRUST,
    SIFT_TRUST,
    Piece,
    Trust,
    connected,
    drop_unsupported,
    worth,
)
from stereogs_plugins.scenes.photos.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
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


def test_a_pair_without_a_third_photograph_needs_more_matches(made: tuple[Any, Path, Any]) -> None:
    colmap, path, model = made
    turn(colmap, model, 2)
    copies = [type(model)(model) for _ in range(2)]
    assert drop_unsupported(colmap, path, model, Trust(15, 15), never)
    assert model.num_reg_images() == 2
    assert not drop_unsupported(colmap, path, copies[0], Trust(15, 1000), never)
    assert drop_unsupported(colmap, path, copies[1], Trust(15, 1000), always)


def test_connected_groups() -> None:
    links = np.zeros((5, 5), dtype=int)
    links[1, 4] = links[0, 3] = links[3, 2] = 7
    assert connected(links) == [[0, 2, 3], [1, 4]]


def test_the_larger_piece_with_a_plausible_lens_wins() -> None:
    pieces = [
        Piece(Path(), members, plausible)
        for members, plausible in (([0, 1], True), ([0, 1, 2], True), ([0, 1, 2, 3], False))
    ]
    assert sorted(pieces, key=lambda piece: worth([piece])) == [pieces[2], pieces[0], pieces[1]]
    assert worth([]) < worth(pieces[:1])


def test_forward_facing_pictures_are_placed(tmp_path: Path) -> None:
    """Three of llff_flower: no pair of them is 16 degrees apart, COLMAP's own minimum."""
    every = sorted((data_folder("llff_flower") / "images_8").iterdir())
    for k in (0, 16, 33):
        (tmp_path / every[k].name).symlink_to(every[k])
    out = tmp_path / "out"
    out.mkdir()
    decoder = Decoder(longest_side(1200), "box", upright=True)
    photos = [photo for photo in read_folder(tmp_path).photos if photo.path.parent == tmp_path]
    found = reconstruct(photos, decoder, True, out)
    assert found.pieces[0].members == [0, 1, 2]
    assert found.pieces[0].plausible
    assert found.pieces[0].folder.parent.name == "incremental_2"
