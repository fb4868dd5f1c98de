"""Dense matches correct inexact cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from registry import Scene
from registry.toolkit.photos import Decoder, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos.dense.matches import dense_matches
from stereogs_plugins.scenes.photos.dense.refinement import (
    MAX_PHOTOS,
    refine,
    with_cropped_lenses,
    with_zoomed_lenses,
)
from stereogs_plugins.scenes.photos.mapping import MAX_ERROR, sampson_distances
from stereogs_plugins.scenes.photos.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import image_index, read_folder
from tests.data import data_folder

colmap = import_pycolmap(3)


@pytest.fixture
def three(model: Any) -> Any:
    """The model with the first three photographs."""
    for k in model.reg_image_ids():
        if image_index(model.image(k).name) > 2:
            model.deregister_frame(model.image(k).frame_id)
    return model


def errors(model: Any, room: Scene) -> tuple[float, float]:
    """Largest error of rotations relative to the first, degrees, and relative error of the focal length."""
    found = {
        image_index(model.image(k).name): model.image(k).cam_from_world().rotation.matrix()
        for k in model.reg_image_ids()
    }
    true = [view.camera.world_to_camera[:3, :3].numpy() for view in room.train]
    turns = [found[k] @ found[0].T @ (true[k] @ true[0].T).T for k in found]
    cosines = [(np.trace(turn) - 1) / 2 for turn in turns]
    (lens,) = model.cameras.values()
    focal = lens.focal_length / lens.width * room.train[0].camera.width / room.train[0].camera.fx
    return float(np.degrees(np.arccos(np.clip(min(cosines), -1, 1)))), abs(focal - 1)


def move(model: Any, axis: NDArray[np.float64], degrees: float) -> None:
    """Turn the last camera on the spot."""
    frame = model.frame(model.image(max(model.reg_image_ids())).frame_id)
    half = np.radians(degrees) / 2
    turn = colmap.Rotation3d(np.array([*np.sin(half) * axis, np.cos(half)]))
    pose = frame.rig_from_world
    frame.rig_from_world = type(pose)(turn * pose.rotation, turn * pose.translation)


def test_inexact_cameras_become_exact(three: Any, images: Path, room: Scene) -> None:
    move(three, np.array([0.6, 0.0, 0.8]), 0.4)
    (lens,) = three.cameras.values()
    lens.params = lens.params * [1.04, 1, 1, 1]
    turned, focal = errors(three, room)
    assert turned > 0.35
    assert focal > 0.03
    refined, focal_is_known, altered = refine(colmap, three, images, [None] * 3)
    assert refined is not three
    assert focal_is_known
    assert altered == ()
    turned, focal = errors(refined, room)
    assert turned < 0.1
    assert focal < 0.01
    assert refined.num_points3D() > 0.9 * three.num_points3D()
    assert max(point.error for point in refined.points3D.values()) <= MAX_ERROR
    colors = {tuple(point.color) for point in three.points3D.values()}
    assert {tuple(point.color) for point in refined.points3D.values()} <= colors


def test_matches_do_not_depend_on_exact_cameras(three: Any, images: Path) -> None:
    """Those found with a turned camera agree with the right cameras."""
    right = colmap.Reconstruction(three)
    move(three, np.array([1.0, 0.0, 0.0]), 0.2)
    matches = dense_matches(three, images)
    assert len(matches) > 300
    last = max(three.reg_image_ids())
    for here in sorted(three.reg_image_ids()):
        seen = [m.seen for m in matches if next(iter(m.seen)) == here and last in m.seen]
        if here == last or not seen:
            continue
        pair = [np.array([one[k] for one in seen]) for k in (here, last)]
        means = [
            float(np.median(sampson_distances(m, (here, last), *pair))) for m in (right, three)
        ]
        assert means[0] < 0.3
        assert means[0] < 0.6 * means[1]


def test_many_photographs_are_left_as_they_are(
    model: Any, images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stereogs_plugins.scenes.photos.dense.refinement.MAX_PHOTOS", 4)
    assert MAX_PHOTOS > model.num_reg_images() > 4
    assert refine(colmap, model, images, [None] * model.num_reg_images()).model is model


def test_exif_replaces_a_focal_length_that_points_do_not_determine(
    three: Any, images: Path, room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = "stereogs_plugins.scenes.photos.dense.refinement"
    camera = room.train[0].camera
    right, wrong = (factor * camera.fx / camera.width for factor in (1, 1.06))
    for key in three.point3D_ids():
        if key % 8:
            three.delete_point3D(key)
    assert errors(refine(colmap, three, images, [wrong] * 3).model, room)[1] < 0.02, (
        "points determine it"
    )
    monkeypatch.setattr(f"{settings}.MIN_INCREASE", 100.0)
    refined, focal_is_known, _ = refine(colmap, three, images, [right] * 3)
    assert focal_is_known
    turned, focal = errors(refined, room)
    assert turned < 0.1
    assert focal < 1e-9
    assert not refine(colmap, three, images, [None] * 3).focal_is_known


@pytest.mark.proof
def test_zoomed_and_cropped_photographs_get_their_own_lens(model: Any) -> None:
    assert with_zoomed_lenses(colmap, model) is model
    assert with_cropped_lenses(colmap, model) is model
    first = min(model.reg_image_ids())
    (lens,) = model.cameras.values()
    middle = np.array([lens.width, lens.height]) / 2
    for point in model.image(first).points2D:
        point.xy = middle + 1.4 * (point.xy - middle)
    own = with_zoomed_lenses(colmap, model)
    focals = {k: own.camera(own.image(k).camera_id).focal_length for k in own.reg_image_ids()}
    assert len(own.cameras) == 2
    assert focals.pop(first) / max(focals.values()) == pytest.approx(1.4, rel=0.02)

    assert with_cropped_lenses(colmap, own) is own
    shift = np.array([0.15, 0.1]) * lens.width
    for point in own.image(first).points2D:
        point.xy = point.xy + shift
    cropped = with_cropped_lenses(colmap, own)
    centres = {
        k: cropped.camera(cropped.image(k).camera_id).params[1:3] for k in cropped.reg_image_ids()
    }
    assert centres.pop(first) - middle == pytest.approx(shift, abs=0.01 * lens.width)
    assert max(abs(centre - middle).max() for centre in centres.values()) == 0


@pytest.mark.proof
def test_an_enlarged_corner_gets_its_own_principal_point(tmp_path: Path) -> None:
    """Five of llff_room, the last without its left and lower quarters, enlarged to the size of the others."""
    every = sorted((data_folder("llff_room") / "images_8").iterdir())[13:18]
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for number, path in enumerate(every):
        with Image.open(path) as opened:
            width, height = opened.size
            box = (width // 4, 0, width, height * 3 // 4) if number == 4 else None
            opened.resize((width, height), box=box).save(tmp_path / "in" / path.name)
    decoder = Decoder(longest_side(1200), "box", upright=True)
    found = reconstruct(read_folder(tmp_path / "in").photos, decoder, True, tmp_path / "out")
    (piece,) = found.pieces
    assert piece.members == [0, 1, 2, 3, 4]
    assert piece.altered == (4,)
    model = colmap.Reconstruction(piece.folder)
    (lens,) = (
        model.camera(model.image(k).camera_id)
        for k in model.reg_image_ids()
        if image_index(model.image(k).name) == 4
    )
    centre = lens.params[1:3] / [lens.width, lens.height]
    assert centre == pytest.approx([1 / 3, 2 / 3], abs=0.03)
