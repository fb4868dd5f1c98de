"""Mapping methods."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from stereogs_plugins.scenes.photos.photogrammetry import structure_from_motion
from stereogs_plugins.scenes.photos.photogrammetry.colmap import read_model
from stereogs_plugins.scenes.photos.photogrammetry.dense.refinement import Refined
from stereogs_plugins.scenes.photos.photogrammetry.focal_lengths import is_plausible
from stereogs_plugins.scenes.photos.photogrammetry.mapping import Piece, _attempts
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.data import data_folder
from tests.stereogs_plugins.scenes.photos.photographs import reconstruct


def place(scene: str, numbers: tuple[int, ...], folder: Path, cropped: int | None = None) -> Piece:
    """The piece of some photographs, one of which lacks its right quarter."""
    every = sorted((data_folder(scene) / "images_8").iterdir())
    (folder / "in").mkdir()
    for number in numbers:
        with Image.open(every[number]) as opened:
            width = opened.width * 3 // 4 if number == cropped else opened.width
            opened.crop((0, 0, width, opened.height)).save(folder / "in" / every[number].name)
    found = reconstruct(read_folder(folder / "in").photos, folder / "out")
    assert found.tried == ("SIFT",)
    return found.pieces[0]


@pytest.mark.parametrize("total", [2, 5])
def test_attempts_with_a_fixed_lens_say_so(total: int) -> None:
    for attempt in _attempts(total):
        fixed = attempt.name.startswith("fixed_lens")
        assert attempt.fixed_lens == fixed
        if isinstance(attempt.run, partial):
            assert attempt.run.args[1] == fixed


def test_forward_facing_pictures_are_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three of llff_flower: no pair of them is 16 degrees apart, COLMAP's own minimum."""
    monkeypatch.setattr(structure_from_motion, "refine", lambda model, *_: Refined(model, True))
    piece = place("llff_flower", (0, 16, 33), tmp_path)
    assert piece.members == [0, 1, 2]
    assert piece.folder.parent.name == "incremental_2"


@pytest.mark.proof
def test_a_lens_without_perspective_is_kept(tmp_path: Path) -> None:
    """Free focal lengths become more than four times the longer side."""
    piece = place("llff_fortress", (9, 11, 13), tmp_path, cropped=11)
    assert piece.members == [0, 1, 2]
    assert piece.folder.parent.name == "fixed_lens_2"
    assert not piece.focal_is_known
    assert is_plausible(read_model(piece.folder), [None] * 3)
