"""Models that matches or pictures contradict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stereogs_plugins.scenes.photos.photogrammetry.colmap import copy_of
from stereogs_plugins.scenes.photos.photogrammetry.support import (
    connected,
    drop_unsupported,
    is_contradicted,
    of_one_scale,
)
from stereogs_plugins.scenes.photos.photogrammetry.thresholds import (
    LEARNED_TRUST,
    SIFT_TRUST,
    Trust,
)
from tests.stereogs_plugins.scenes.photos.photographs import turn

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model

    Synthetic = tuple[Path, Model]


def turn_first(model: Model, count: int) -> list[int]:
    """Turn the cameras of some photographs by multiples of 23 degrees; return their ids."""
    ids = sorted(model.reg_image_ids())[:count]
    for number, image in enumerate(ids, start=1):
        turn(model, image, (0, 0, 1), 23 * number)
    return ids


def always(model: Model, first: int, second: int) -> bool:
    return True


def never(model: Model, first: int, second: int) -> bool:
    return False


def test_a_supported_model_keeps_its_photographs(synthetic: Synthetic) -> None:
    path, model = synthetic
    assert drop_unsupported(path, model, SIFT_TRUST, never)
    assert model.num_reg_images() == 4


def test_pictures_decide_where_matches_do_not_suffice(synthetic: Synthetic) -> None:
    path, model = synthetic
    seen = []

    def same(model: Model, first: int, second: int) -> bool:
        seen.append((first, second))
        return 4 not in (first, second)

    copy = copy_of(model)
    assert drop_unsupported(path, model, LEARNED_TRUST, same)
    assert sorted(model.reg_image_ids()) == [1, 2, 3]
    assert len(seen) == 3, "two links, and one attempt to add the fourth"
    assert not drop_unsupported(path, copy, LEARNED_TRUST, never)


def test_a_wrong_camera_is_removed(synthetic: Synthetic) -> None:
    path, model = synthetic
    assert not is_contradicted(path, model)
    (wrong,) = turn_first(model, 1)
    assert is_contradicted(path, model)
    assert drop_unsupported(path, model, SIFT_TRUST, never)
    assert wrong not in model.reg_image_ids()
    assert model.num_reg_images() == 3


def test_a_mirrored_camera_is_removed(synthetic: Synthetic) -> None:
    """Its epipolar lines are the true ones, but the points are behind it."""
    path, model = synthetic
    first, second, *_ = sorted(model.reg_image_ids())
    pose, other = (model.image(k).cam_from_world() for k in (first, second))
    motion = other * pose.inverse()
    motion.translation = -motion.translation
    model.frame(model.image(second).frame_id).rig_from_world = motion * pose
    assert is_contradicted(path, model)
    for k in sorted(model.reg_image_ids())[2:]:
        model.deregister_frame(model.image(k).frame_id)
    assert not drop_unsupported(path, model, Trust(15, 15), always)


def test_a_wrong_model_is_discarded(synthetic: Synthetic) -> None:
    path, model = synthetic
    turn_first(model, 4)
    assert not drop_unsupported(path, model, SIFT_TRUST, never)


def test_a_pair_without_a_third_photograph_needs_more_matches(synthetic: Synthetic) -> None:
    path, model = synthetic
    turn_first(model, 2)
    copies = [copy_of(model) for _ in range(2)]
    assert drop_unsupported(path, model, Trust(15, 15), never)
    assert model.num_reg_images() == 2
    assert not drop_unsupported(path, copies[0], Trust(15, 1000), never)
    assert drop_unsupported(path, copies[1], Trust(15, 1000), always)


def test_parts_without_common_points_have_no_common_scale(synthetic: Synthetic) -> None:
    _, model = synthetic
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
