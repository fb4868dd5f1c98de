"""Cameras of photographs that SIFT does not match, by the networks in STEREOGS_MODELS."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry import PluginError
from registry.toolkit.photos import Decoder, evenly_spaced, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos import learned_matches
from stereogs_plugins.scenes.photos.learned_matches import FINDER, MATCHER, known_files
from stereogs_plugins.scenes.photos.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.data import data_folder, models_folder


def test_networks_are_used_if_both_files_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    assert known_files() is None
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    (tmp_path / FINDER[0].parent).mkdir()
    (tmp_path / FINDER[0]).write_bytes(b"not a network")
    assert known_files() is None
    (tmp_path / MATCHER[0]).write_bytes(b"nor is this")
    files = known_files()
    assert files == (tmp_path / FINDER[0], tmp_path / MATCHER[0])
    colmap = import_pycolmap()
    with pytest.raises(PluginError, match="SHA-256"):
        learned_matches.add_learned_matches(colmap, files, tmp_path, tmp_path, tmp_path)


@pytest.mark.proof
def test_pictures_far_apart_are_placed_by_the_networks(tmp_path: Path) -> None:
    """Six of dtu_scan65's 49: SIFT places two of them."""
    models_folder("aliked_lightglue")
    photos = read_folder(data_folder("dtu_scan65") / "image").photos
    chosen = [photos[k] for k in evenly_spaced(list(range(len(photos))), 6)]
    decoder = Decoder(longest_side(1200), "box", upright=True)
    for folder in ("first", "again"):
        (tmp_path / folder).mkdir()
    found, same = (reconstruct(chosen, decoder, True, tmp_path / x) for x in ("first", "again"))
    assert found.tried == ("SIFT", "pooled SIFT", "SIFT with ALIKED and LightGlue")
    assert len(found.pieces[0].members) >= 4
    files = [(one.pieces[0].folder / "images.bin").read_bytes() for one in (found, same)]
    assert files[0] == files[1], "the same bits"
