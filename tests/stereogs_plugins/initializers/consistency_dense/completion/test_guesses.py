"""Guesses and coarse layers where no depth is confirmed."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from registry import PointCloud, Scene, SceneError, View
from stereogs_plugins.initializers.consistency_dense.completion import matched
from stereogs_plugins.initializers.sfm import SfmInitializer
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.initializers.consistency_dense.dense import COMPLETE, dense
from tests.stereogs_plugins.initializers.depth_scenes import (
    as_it_is,
    true_depth,
)


def test_completion_fills_the_holes_of_the_filter(scene: Scene) -> None:
    bare = dense(scene, stride=3, sigma=0.5, opacity=0.9, max_points=None)
    full = dense(scene, stride=3, sigma=0.5, opacity=0.9, max_points=None, **COMPLETE)
    assert set(bare.facts["points_by_kind"]) == {"confirmed", "filled"}
    assert bare.facts["points_by_kind"]["filled"] == 0
    assert sum(full.facts["points_by_kind"].values()) == len(full)
    assert all(count > 0 for count in full.facts["points_by_kind"].values())
    assert full.scales is not None
    assert full.opacities is not None
    assert torch.equal(full.opacities, torch.full((len(full),), 0.9))
    for view in scene.train:
        facts = full.facts["views"][view.name]
        assert facts["coverage"] == 1
        assert 0.6 < facts["consistent"] < 1
        assert 0.95 < facts["consistent"] + facts["filled"] <= 1
        truth = np.quantile(true_depth(view).numpy(), (0.05, 0.5, 0.95))
        np.testing.assert_allclose(facts["depth_quantiles"], truth, rtol=0.1)


def in_lowest(share: float) -> Callable[[View], Tensor]:
    """True depths in the lowest rows alone."""

    def depth_of(view: View) -> Tensor:
        depth = true_depth(view).clone()
        depth[: round((1 - share) * depth.shape[0])] = 0
        return depth

    return depth_of


def test_the_rest_is_guessed_if_much_is_confirmed(scene: Scene) -> None:
    kinds = dense(scene, in_lowest(0.5), **COMPLETE).facts["points_by_kind"]
    assert kinds["confirmed"] > 0
    assert kinds["filled"] > 0


def test_matched_features_replace_points_if_little_is_confirmed(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    points = dense(scene, in_lowest(0.15), stride=3, sigma=0.5, opacity=0.9, **COMPLETE)
    assert "too little to guess" in caplog.text
    assert "stereogs check" in caplog.text
    assert f"starts from {len(points)} matched features" in caplog.text
    assert points.facts["points_by_kind"] == {"matched": len(points)}
    assert points.kinds["matched"].all()
    sparse = build(SfmInitializer, source="triangulate").initialize(as_it_is(scene), {})
    assert torch.equal(points.positions, sparse.positions)
    assert torch.equal(points.colors, sparse.colors)
    assert points.scales is points.opacities is None  # as `sfm` has them
    few = dense(scene, in_lowest(0.15), stride=3, max_points=50, **COMPLETE)
    assert len(few) == 50


def test_the_confirmed_share_does_not_depend_on_fill_shown(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    for fill_shown in (True, False):
        dense(scene, in_lowest(0.15), stride=3, fill_shown=fill_shown, **COMPLETE)
    said = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(said) == 2
    assert said[0] == said[1]


def test_confirmed_points_stay_if_few_features_match(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = dense(scene, in_lowest(0.15), **COMPLETE).facts["points_by_kind"]
    assert every["confirmed"] > 6_000  # a point a pixel: features are less than a tenth
    assert every["filled"] == 0

    def none(*_: object, **__: object) -> PointCloud:
        raise SceneError("no point could be triangulated")

    monkeypatch.setattr(matched, "triangulated_points", none)
    sparse = dense(scene, in_lowest(0.15), stride=3, **COMPLETE).facts["points_by_kind"]
    assert sparse["confirmed"] > 0
    assert sparse["filled"] == 0


def right_half_unknown(view: View) -> Tensor:
    depth = true_depth(view).clone()
    depth[:, depth.shape[1] // 2 :] = 0
    return depth


def test_nothing_is_guessed_where_a_pixel_shows_the_background(scene: Scene) -> None:
    def with_empty_rows(view: View) -> View:
        image = view.image.clone()
        image[:60] = 1
        return replace(view, image=image)

    empty = replace(scene, train=tuple(map(with_empty_rows, scene.train)), background=(1.0, 1, 1))
    shares = [
        dense(s, right_half_unknown, **COMPLETE).facts["views"][scene.train[0].name]["filled"]
        for s in (scene, empty)
    ]
    assert shares[0] > 0.4
    assert shares[1] == pytest.approx(shares[0] * 129 / 189, abs=0.03)
    layers = dense(empty, right_half_unknown, **COMPLETE)
    guessed = layers.facts["points_by_kind"]["confirmed"]  # those come first
    assert ((layers.colors[guessed:] - 1).abs() > 2 / 255).any(dim=1).all()


def test_background_range_is_the_tolerance_of_the_background(scene: Scene) -> None:
    def nearly_white_within(view: View) -> View:
        image = view.image.clone()
        image[60:120, 150:230] = 1 - 10 / 255
        return replace(view, image=image)

    white = replace(
        scene, train=tuple(map(nearly_white_within, scene.train)), background=(1.0, 1, 1)
    )
    shares = [
        dense(white, right_half_unknown, background_range=levels, **COMPLETE).facts["views"][
            scene.train[0].name
        ]["filled"]
        for levels in (2, 9, 12)
    ]
    assert shares[0] == shares[1]
    assert shares[2] == pytest.approx(shares[0] - 60 * 80 / (189 * 252), abs=0.01)


def test_fill_shown_false_skips_what_another_view_shows(scene: Scene) -> None:
    first = scene.train[0].name

    def right_half_unknown(view: View) -> Tensor:
        depth = true_depth(view).clone()
        if view.name == first:
            depth[:, depth.shape[1] // 2 :] = 0
        return depth

    every, fewer = (
        dense(scene, right_half_unknown, fill=True, fill_shown=also) for also in (True, False)
    )
    shares = [points.facts["views"][first]["filled"] for points in (every, fewer)]
    assert shares[0] > 0.4
    assert shares[1] < 0.6 * shares[0]
    counts = [points.facts["points_by_kind"] for points in (every, fewer)]
    assert counts[0]["confirmed"] == counts[1]["confirmed"]
    assert counts[0]["filled"] > counts[1]["filled"]


def test_nothing_is_guessed_on_a_plain_background_of_any_color(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    backdrop = torch.ones(189, 252, dtype=torch.bool)
    backdrop[40:150, 60:190] = False

    def before_blue(view: View) -> View:
        blue = torch.tensor((0.2, 0.3, 0.6))
        return replace(view, image=torch.where(backdrop[..., None], blue, view.image))

    def depth_of(view: View) -> Tensor:
        return torch.where(backdrop, 0.0, true_depth(view))

    with caplog.at_level(logging.INFO):
        points = dense(
            replace(scene, train=tuple(map(before_blue, scene.train))), depth_of, **COMPLETE
        )
    assert "taken as object" in caplog.text
    assert points.facts["scene_kind"] == "object"
    assert points.facts["plain_background"] == pytest.approx(0.7, abs=0.05)
    assert list(points.kinds) == ["confirmed", "filled", "back_layer", "margin"]
    guessed = points.positions[points.facts["points_by_kind"]["confirmed"] :]
    assert len(guessed) > 100
    for view in scene.train:
        u, v, depth = view.camera.project(guessed)
        inside = (depth > 0) & (u > 10) & (u < 242) & (v > 10) & (v < 179)
        beside = inside & ((u < 50) | (u > 200) | (v < 30) | (v > 160))
        assert not beside.any()
    room = dense(scene, stride=4, **COMPLETE)
    assert room.facts["scene_kind"] == "forward-facing"
    assert list(room.kinds) == ["confirmed", "filled", "back_layer", "margin", "hidden"]
    behind = room.kinds["back_layer"]
    assert not (room.kinds["hidden"] & ~behind).any()
    assert 0.5 < float(room.kinds["hidden"].sum() / behind.sum()) < 1


@pytest.mark.parametrize("plain_background", [True, False])
def test_on_objects_guesses_need_a_color_that_other_views_show(
    scene: Scene, plain_background: bool
) -> None:
    backdrop = torch.zeros(189, 252, dtype=torch.bool)
    backdrop[:60] = plain_background
    unknown = torch.zeros_like(backdrop)
    unknown[100:150, 60:190] = True

    def painted(view: View) -> View:
        image = torch.where(backdrop[..., None], 0.0, view.image)
        if view.name == scene.train[0].name:
            image[110:140, 80:170] = torch.tensor((1.0, 0.0, 1.0))
        return replace(view, image=image)

    def depth_of(view: View) -> Tensor:
        return torch.where(backdrop | unknown, 0.0, true_depth(view))

    points = dense(
        replace(scene, train=tuple(map(painted, scene.train))), depth_of, stride=3, fill=True
    )
    assert (points.facts["scene_kind"] == "object") == plain_background
    purple = ((points.colors - torch.tensor((1.0, 0.0, 1.0))).abs() < 0.1).all(dim=1)
    assert (int(purple.sum()) < 30) == plain_background


@pytest.mark.parametrize("plain_background", [True, False])
def test_planes_are_continued_except_around_objects(scene: Scene, plain_background: bool) -> None:
    backdrop = torch.zeros(189, 252, dtype=torch.bool)
    backdrop[:60] = plain_background

    def painted(view: View) -> View:
        return replace(view, image=torch.where(backdrop[..., None], 0.0, view.image))

    def depth_of(view: View) -> Tensor:
        depth = torch.where(backdrop, 0.0, true_depth(view))
        depth[100:150, 60:190] = 0
        return depth

    shown = replace(scene, train=tuple(map(painted, scene.train)))
    plain, planes = (
        dense(shown, depth_of, stride=3, fill=True, fill_planes=wanted) for wanted in (False, True)
    )
    assert (plain.facts["scene_kind"] == "object") == plain_background
    assert torch.equal(plain.positions, planes.positions) == plain_background
