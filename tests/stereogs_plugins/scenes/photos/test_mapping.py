"""Mapping methods, and models that the matches contradict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from registry.toolkit.photos import Decoder, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos.mapping import (
    LEAST_SUPPORT,
    MAX_ERROR,
    Piece,
    agreeing_share,
    worth,
)
from stereogs_plugins.scenes.photos.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.data import data_folder


def test_a_model_with_a_wrong_camera_is_contradicted_by_its_matches(tmp_path: Path) -> None:
    colmap = import_pycolmap(3)
    colmap.set_random_seed(0)
    options = colmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 4
    options.num_points3D = 60
    path = tmp_path / "matches.db"
    with colmap.Database.open(path) as database:
        model = colmap.synthesize_dataset(options, database)
    assert agreeing_share(colmap, path, model, 2 * MAX_ERROR) == 1
    frame = model.frame(next(iter(model.reg_frame_ids())))
    moved = frame.rig_from_world
    turn = colmap.Rotation3d(np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)]))
    frame.rig_from_world = colmap.Rigid3d(turn * moved.rotation, moved.translation)
    assert agreeing_share(colmap, path, model, 2 * MAX_ERROR) < LEAST_SUPPORT


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
    photos = [photo for photo in read_folder(tmp_path) if photo.path.parent == tmp_path]
    found = reconstruct(photos, decoder, True, out)
    assert found.pieces[0].members == [0, 1, 2]
    assert found.pieces[0].plausible
    assert found.pieces[0].folder.parent.name == "incremental_2"
