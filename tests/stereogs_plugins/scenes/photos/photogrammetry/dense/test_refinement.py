"""Dense matches correct inexact cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from registry import Scene
from stereogs_plugins.scenes.photos.photogrammetry import thresholds
from stereogs_plugins.scenes.photos.photogrammetry.colmap import (
    copy_of,
    index_of,
    relative_focal,
    set_focal,
)
from stereogs_plugins.scenes.photos.photogrammetry.dense.matches import dense_matches
from stereogs_plugins.scenes.photos.photogrammetry.dense.refinement import refine
from stereogs_plugins.scenes.photos.photogrammetry.two_view import sampson_distances
from tests.stereogs_plugins.scenes.photos.photographs import relative_turns, turn

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model

pytestmark = pytest.mark.proof


@pytest.fixture
def three(model: Model) -> Model:
    """The model with the first three photographs."""
    for k in model.reg_image_ids():
        if index_of(model, k) > 2:
            model.deregister_frame(model.image(k).frame_id)
    return model


def errors(model: Model, room: Scene) -> tuple[float, float]:
    """Largest error of rotations relative to the first, degrees, and relative error of the focal length."""
    images = {index_of(model, k): model.image(k) for k in sorted(model.reg_image_ids())}
    found = [images[k].cam_from_world().rotation.matrix() for k in images]
    true = [room.train[k].camera.world_to_camera[:3, :3].numpy() for k in images]
    (lens,) = model.cameras.values()
    camera = room.train[0].camera
    focal = relative_focal(lens) * camera.width / camera.fx
    turns = relative_turns(found, true)[: len(found) - 1]  # those to the first
    return float(turns.max()), abs(focal - 1)


def test_inexact_cameras_become_exact(three: Model, images: Path, room: Scene) -> None:
    turn(three, max(three.reg_image_ids()), (0.6, 0.0, 0.8), 0.4)
    (lens,) = three.cameras.values()
    set_focal(lens, 1.04 * lens.focal_length)
    turned, focal = errors(three, room)
    assert turned > 0.35
    assert focal > 0.03
    refined, focal_is_known, altered = refine(three, images, [None] * 3)
    assert refined is not three
    assert focal_is_known
    assert altered == ()
    turned, focal = errors(refined, room)
    assert turned < 0.1
    assert focal < 0.01
    assert refined.num_points3D() > 0.9 * three.num_points3D()
    points = refined.points3D.values()
    assert max(point.error for point in points) <= thresholds.MAX_ERROR
    colors = {tuple(point.color) for point in three.points3D.values()}
    assert {tuple(point.color) for point in points} <= colors


def test_matches_do_not_depend_on_exact_cameras(three: Model, images: Path) -> None:
    """Those found with a turned camera agree with the right cameras."""
    right, last = copy_of(three), max(three.reg_image_ids())
    turn(three, last, (1.0, 0.0, 0.0), 0.2)
    matches = [dict(match.seen) for match in dense_matches(three, images)]
    assert len(matches) > 300
    for here in sorted(three.reg_image_ids()):
        seen = [places for places in matches if next(iter(places)) == here and last in places]
        if here == last or not seen:
            continue
        pair = [np.array([places[k] for places in seen]) for k in (here, last)]
        means = [
            float(np.median(sampson_distances(m, (here, last), *pair))) for m in (right, three)
        ]
        assert means[0] < 0.3
        assert means[0] < 0.6 * means[1]


def test_many_photographs_are_left_as_they_are(
    model: Model, images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert thresholds.MAX_REFINED > model.num_reg_images() > 4
    monkeypatch.setattr(thresholds, "MAX_REFINED", 4)
    assert refine(model, images, [None] * model.num_reg_images()).model is model


def test_exif_replaces_a_focal_length_that_points_do_not_determine(
    three: Model, images: Path, room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = room.train[0].camera
    right, wrong = (factor * camera.fx / camera.width for factor in (1, 1.06))
    for key in three.point3D_ids():
        if key % 8:
            three.delete_point3D(key)
    by_points = refine(three, images, [wrong] * 3).model
    assert errors(by_points, room)[1] < 0.02, "points determine it"
    monkeypatch.setattr(thresholds, "MIN_INCREASE", 100.0)
    refined, focal_is_known, _ = refine(three, images, [right] * 3)
    assert focal_is_known
    turned, focal = errors(refined, room)
    assert turned < 0.1
    assert focal < 1e-9
    assert not refine(three, images, [None] * 3).focal_is_known
