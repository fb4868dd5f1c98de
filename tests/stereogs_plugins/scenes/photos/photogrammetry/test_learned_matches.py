"""Cameras of photographs that SIFT does not match, by the networks in STEREOGS_MODELS."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from registry import PluginError
from registry.toolkit.networks import KeypointNetworks, OnnxModel
from registry.toolkit.photos import evenly_spaced, read_colmap_model
from stereogs_plugins.scenes.dtu.cameras import calibrated
from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_name, mask_of
from stereogs_plugins.scenes.photos.photogrammetry.learned_matches import (
    FOLDER,
    KNOWN,
    _keypoints,
    add_learned_matches,
    known_files,
)
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, read_folder
from tests.data import data_folder, models_folder
from tests.host import KNOWN_NETWORKS
from tests.stereogs_plugins.scenes.photos.photographs import reconstruct, relative_turns


def test_networks_are_used_if_both_files_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    assert known_files() is None
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    (tmp_path / FOLDER).mkdir()
    for names in reversed(KNOWN):
        finder, matcher = (tmp_path / FOLDER / name for name in names)
        before = known_files()
        finder.write_bytes(b"not a network")
        assert known_files() == before
        matcher.write_bytes(b"nor is this")
        files = known_files()
        assert files == (finder, matcher)
    assert files is not None
    with pytest.raises(PluginError, match="SHA-256"):
        add_learned_matches(files, tmp_path, tmp_path, tmp_path, [])


def test_what_is_obtained_is_known() -> None:
    network = KNOWN_NETWORKS["aliked-lightglue"]
    (source,) = network.sources
    written, earlier = ({f"{FOLDER}/{name}": sha for name, sha in names.items()} for names in KNOWN)
    assert source.writes == written
    assert network.earlier == tuple(earlier)


@pytest.mark.proof
def test_no_keypoint_is_where_a_mask_is_black(tmp_path: Path) -> None:
    models_folder("aliked_lightglue")
    files = known_files()
    assert files is not None
    hashes = {name: sha256 for names in KNOWN for name, sha256 in names.items()}
    networks = KeypointNetworks(*(OnnxModel(f, hashes[f.name]) for f in files), multiple=1)
    picture = tmp_path / "images" / image_name(0)
    picture.parent.mkdir()
    with Image.open(sorted((data_folder("llff_fern") / "images_8").iterdir())[0]) as opened:
        opened.convert("RGB").save(picture)
        mask = Image.new("L", opened.size, 255)
    whole = _keypoints(networks, picture)
    mask.paste(0, (0, 0, mask.width // 2, mask.height))
    mask_of(picture).parent.mkdir()
    mask.save(mask_of(picture))
    half = _keypoints(networks, picture)
    right = whole.points[:, 0] >= mask.width // 2
    assert right.float().mean() < 0.9
    assert half.points[:, 0].min() >= mask.width // 2
    assert len(half.points) >= right.sum()
    assert len(half.points) == half.normalized.shape[1] == half.descriptors.shape[1]


def place(photos: list[UnposedPhoto], count: int, folder: Path) -> Reconstruction:
    """Cameras of evenly spaced photographs, with the networks if SIFT does not place all."""
    models_folder("aliked_lightglue")
    return reconstruct([photos[k] for k in evenly_spaced([*range(len(photos))], count)], folder)


def largest_turn(found: Reconstruction, folder: Path, views: list[int]) -> float:
    """Largest error of a rotation between two of the pictures of DTU, degrees."""
    truth = calibrated(folder / "cameras_sphere.npz", views).cameras
    model = read_colmap_model(found.pieces[0].folder, "")
    poses = [image.world_to_camera[:3, :3] for _, image in model.images]
    true = [truth[view].world_to_camera[:3, :3] for view in views]
    return float(relative_turns(poses, true).max())


@pytest.mark.proof
def test_three_pictures_far_apart_are_confirmed_by_the_dense_check(tmp_path: Path) -> None:
    """Three of dtu_scan65, 53 to 62 degrees apart: of the three pairs two have 181 and 53 matches."""
    folder = data_folder("dtu_scan65")
    found = place(read_folder(folder / "image").photos, 3, tmp_path)
    assert found.pieces[0].members == [0, 1, 2]
    assert largest_turn(found, folder, [0, 24, 48]) < 5


@pytest.mark.proof
def test_networks_also_contradict_a_focal_length_in_exif(tmp_path: Path) -> None:
    """Three of dtu_scan24 with a quarter of their focal length: a free lens near it is 26 degrees off."""
    folder = data_folder("dtu_scan24")
    photos = [replace(photo, focal=0.45) for photo in read_folder(folder / "image").photos]
    found = place(photos, 3, tmp_path)
    assert found.tried[-1] == "SIFT with ALIKED and LightGlue without EXIF"
    assert found.ignores_exif
    assert found.pieces[0].members == [0, 1, 2]
    assert largest_turn(found, folder, [0, 24, 48]) < 2


@pytest.mark.proof
def test_opposite_sides_of_a_symmetric_object_are_not_connected(tmp_path: Path) -> None:
    """Four of lego: 42 matches connect opposite sides, 178 degrees off."""
    photos = read_folder(data_folder("blender_lego") / "train").photos
    found = place(sorted(photos, key=lambda photo: (len(photo.name), photo.name)), 4, tmp_path)
    assert found.tried[-1] == "SIFT with ALIKED and LightGlue"
    assert "pictures" in found.doubts.values()
    assert max(len(piece.members) for piece in found.pieces) == 2


@pytest.mark.proof
def test_pictures_far_apart_are_placed_by_the_networks(tmp_path: Path) -> None:
    """Six of dtu_scan65's 49: SIFT places two of them."""
    photos = read_folder(data_folder("dtu_scan65") / "image").photos
    found, same = (place(photos, 6, tmp_path / name) for name in ("first", "again"))
    assert found.tried == ("SIFT", "pooled SIFT", "SIFT with ALIKED and LightGlue")
    assert len(found.pieces[0].members) >= 4
    files = [(both.pieces[0].folder / "images.bin").read_bytes() for both in (found, same)]
    assert files[0] == files[1], "the same bits"
