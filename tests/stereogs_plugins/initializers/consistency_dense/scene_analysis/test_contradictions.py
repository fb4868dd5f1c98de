"""Views outvote contradicted depths; one view of another colour drops a guess."""

from __future__ import annotations

import numpy as np
import torch

from registry import View
from stereogs_plugins.initializers.consistency_dense.projection import DepthImage
from stereogs_plugins.initializers.consistency_dense.scene_analysis.contradictions import (
    Evidence,
    miscolored,
    without_outvoted,
)
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, view_of

BOUNDS = (1.0, 10.0)
CAMERA = camera_at(0.0)
PATCH = np.s_[15:25, 25:35]
POINTS = np.array(
    [
        [0.0, 0.0, 2.0],  # before the wall
        [0.0, 0.0, 3.99],  # on it
        [0.0, 0.0, 5.0],  # behind it
        [9.0, 0.0, 4.0],  # beside the image
        [0.0, 0.0, -2.0],  # behind the camera
    ]
)
NO, YES = [False] * 5, [True, True, True, False, False]


def wall(depth: float = 4.0) -> DepthImage:
    return np.full((40, 60), depth, dtype=np.float32)


def row_of_views(count: int = 4) -> list[View]:
    return [view_of(camera_at(0.2 * index), name=f"view{index}") for index in range(count)]


def black(view: View) -> View:
    return view_of(view.camera, torch.zeros_like(view.image), view.name)


def grey(value: float = 0.5) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    return np.full((len(POINTS), 3), value, dtype=np.float32)


def test_a_view_with_depth_votes_by_depth() -> None:
    evidence = Evidence.of(view_of(CAMERA), wall())
    past, miscoloured, confirmed = evidence.votes(POINTS, grey(0.0), CAMERA)
    assert past.tolist() == [True, False, False, False, False]
    assert miscoloured.tolist() == NO
    assert confirmed.tolist() == [False, True, False, False, False]


def test_a_view_without_depth_votes_by_color() -> None:
    view = view_of(CAMERA)
    evidence = Evidence.of(view, wall(0.0))
    for colors, expected in ((grey(0.0), YES), (grey(0.35), NO), (grey(0.65), NO), (grey(1), YES)):
        past, miscoloured, confirmed = evidence.votes(POINTS, colors, CAMERA)
        assert miscoloured.tolist() == expected
        assert not past.any()
        assert not confirmed.any()


def test_a_color_may_lie_a_few_pixels_off() -> None:
    def seen_with_dot_at(column: int) -> bool:
        image = torch.zeros(40, 60, 3)
        image[20, column] = 0.5
        evidence = Evidence.of(view_of(CAMERA, image), wall(0.0))
        return not miscolored(POINTS[:1], grey()[:1], CAMERA, [evidence])[0]

    assert seen_with_dot_at(33)
    assert not seen_with_dot_at(34)


def test_colors_of_a_view_from_another_side_are_ignored() -> None:
    evidence = Evidence.of(view_of(CAMERA), wall(0.0))
    for sideways, expected in ((1.9, True), (2.1, False)):
        beside = camera_at(sideways)  # the first point is at a distance of 2: 45 degrees between
        assert miscolored(POINTS[:1], grey(0.0)[:1], beside, [evidence])[0] == expected


def test_a_chance_agreement_in_front_of_a_confirmed_surface_is_dropped() -> None:
    depths = [wall() for _ in range(4)]
    depths[0][PATCH] = 2.0
    kept = without_outvoted(row_of_views(), depths, BOUNDS)
    assert not kept[0][PATCH].any()
    outside = np.ones((40, 60), dtype=np.bool_)
    outside[PATCH] = False
    assert (kept[0][outside] == 4).all()
    assert all((depth == 4).all() for depth in kept[1:])


def test_a_tied_vote_keeps_the_depth() -> None:
    views, depths = row_of_views(3), [wall(), wall(), wall(6.0)]
    kept = without_outvoted(views, depths, BOUNDS)
    assert (kept[0] == 4).all()


def test_another_color_in_views_without_depth_drops_a_depth() -> None:
    views = row_of_views()
    views[0] = black(views[0])
    depths = [wall(), wall(0.0), wall(0.0), wall(0.0)]
    depths[2][:, :5] = 4.0
    kept = without_outvoted(views, depths, BOUNDS)
    assert not kept[0][:, 20:].any()
    assert (kept[2][:, :2] == 4).all()


def test_colors_are_ignored_if_none_match() -> None:
    views = row_of_views(2)
    views[0] = black(views[0])
    depths = [wall(), wall(0.0)]
    depths[0][:, :5] = 0.0
    kept = without_outvoted(views, depths, BOUNDS)
    assert np.array_equal(kept[0], depths[0])


def test_without_evidence_no_point_is_miscolored() -> None:
    assert not miscolored(POINTS, grey(), CAMERA, []).any()
