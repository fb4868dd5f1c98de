from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from torch import Tensor

from registry import PluginError, PointCloud, Scene, SceneError, View
from stereogs_plugins.initializers.consistency_dense import (
    ConsistencyDense,
    stereogs_register_initializers,
)
from stereogs_plugins.priors.plane_sweep import PlaneSweep
from stereogs_plugins.scenes.llff import LLFFScene
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.initializers.consistency_dense.dense import COMPLETE, dense
from tests.stereogs_plugins.initializers.depth_scenes import (
    as_it_is,
    camera_towards_origin,
    distance_to_surface,
    plane_depth,
    prior_of,
    true_depth,
    view_of,
)


def test_registers_as_consistency_dense() -> None:
    assert offered(stereogs_register_initializers) == {"consistency_dense": ConsistencyDense}


def test_points_lie_on_the_true_surfaces_despite_outliers(scene: Scene) -> None:
    generator = torch.Generator().manual_seed(0)

    def spoilt(view: View) -> Tensor:
        depth = true_depth(view)
        wrong = torch.rand(depth.shape, generator=generator) < 0.05
        return torch.where(wrong, 1.5 * depth, depth)

    points = dense(scene, spoilt, stride=2)
    assert len(points) > 0.7 * 3 * 252 * 189 / 4
    error = distance_to_surface(scene, points)
    assert error.quantile(0.999) < 0.02
    assert points.scales is None
    assert points.opacities is None


def test_depths_that_are_unknown_never_become_points(scene: Scene) -> None:
    def damaged(view: View) -> Tensor:
        depth = true_depth(view).clone()
        depth[:40], depth[40:60], depth[60:80] = torch.nan, 0.0, -1.0
        return depth

    points = dense(scene, damaged)
    assert torch.isfinite(points.positions).all()
    for view in scene.train:
        assert points.facts["views"][view.name]["coverage"] == pytest.approx(109 / 189, abs=1e-3)
    assert distance_to_surface(scene, points).quantile(0.999) < 0.02


def test_size_follows_distance_stride_and_sigma(scene: Scene) -> None:
    points = dense(scene, stride=4, sigma=0.5)
    view = scene.train[0]
    pose = view.camera.world_to_camera
    first = points.positions[:100].double() @ pose[2, :3] + pose[2, 3]
    assert points.scales is not None
    expected = (0.5 * 4 * first / view.camera.fx).float()
    torch.testing.assert_close(points.scales[:100], expected, rtol=1e-5, atol=0)


def test_pictures_show_photograph_and_three_depths(scene: Scene) -> None:
    points = dense(scene, **COMPLETE)
    assert list(points.pictures) == [f"{view.name}_depth" for view in scene.train]
    for view, picture in zip(scene.train, points.pictures.values(), strict=True):
        assert picture.shape == (189, 4 * 252 + 3 * 4, 3)
        assert torch.equal(picture[:, :252], view.image)
        holes = (picture[:, 2 * 256 : 2 * 256 + 252] == 0).all(dim=2)
        share = points.facts["views"][view.name]["consistent"]
        assert 1 - float(holes.float().mean()) == pytest.approx(share, abs=1e-3)


def test_the_cap_is_kept_and_one_seed_gives_one_choice(scene: Scene) -> None:
    def points(seed: int) -> PointCloud:
        component = build(ConsistencyDense, seed, max_points=1000, sigma=1.0)
        return component.initialize(as_it_is(scene), {"depth": prior_of(true_depth)})

    first, again, other = points(1), points(1), points(2)
    assert len(first) == first.facts["points_by_kind"]["confirmed"] == 1000
    assert torch.equal(first.positions, again.positions)
    assert not torch.equal(first.positions, other.positions)


def test_depth_is_estimated_of_max_views_only(scene: Scene) -> None:
    asked = []

    def depth_of(view: View) -> Tensor:
        asked.append(view.name)
        return true_depth(view)

    points = dense(scene, depth_of, max_views=2, hand_on_depth=True)
    names = [view.name for view in scene.train]
    assert asked == names[:2]
    assert list(points.maps) == list(points.facts["views"]) == names[:2]
    assert len(points) == len(dense(replace(scene, train=scene.train[:2])))


def test_one_view_and_too_few_views_are_explained(scene: Scene) -> None:
    with pytest.raises(SceneError, match="one training view") as caught:
        dense(replace(scene, train=scene.train[:1]))
    assert "random" in caught.value.fix
    with pytest.raises(SceneError, match="3 other views must confirm") as caught:
        dense(scene, min_consistent=3)
    assert "at most 2" in caught.value.fix


def test_views_that_agree_on_nothing_are_explained(scene: Scene) -> None:
    depths = {view.name: float(2 + index) for index, view in enumerate(scene.train)}
    with pytest.raises(SceneError, match="no pixel") as caught:
        dense(scene, lambda view: torch.full(view.image.shape[:2], depths[view.name]))
    assert "overlap" in caught.value.fix


def test_an_unconfirmed_view_is_reported(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    lost = scene.train[1].name

    def depth_of(view: View) -> Tensor:
        return 0.3 * true_depth(view) if view.name == lost else true_depth(view)

    with caplog.at_level(logging.WARNING):
        points = dense(scene, depth_of, min_component=100, **COMPLETE)
    assert lost in caplog.text
    assert points.facts["views_without_confirmed_depth"] == 1
    assert points.facts["views"][lost] == {
        "coverage": 1.0,
        "consistent": 0.0,
        "filled": 0.0,
        "depth_quantiles": [],
    }
    assert len(points) > 1000


def test_a_prior_is_needed(scene: Scene) -> None:
    with pytest.raises(PluginError, match="multi_view_depth"):
        build(ConsistencyDense).initialize(as_it_is(scene), {})
    priors = {name: prior_of(true_depth) for name in ("one", "two")}
    with pytest.raises(PluginError, match="2 priors"):
        build(ConsistencyDense).initialize(as_it_is(scene), priors)
    assert len(build(ConsistencyDense, prior="two").initialize(as_it_is(scene), priors)) > 1000


def test_several_priors_fill_the_holes_of_each_other(scene: Scene) -> None:
    def half(start: int, stop: int) -> Any:
        def depth_of(view: View) -> Tensor:
            depth = torch.zeros(189, 252)
            depth[start:stop] = true_depth(view)[start:stop]
            return depth

        return prior_of(depth_of)

    priors = {"upper": half(0, 90), "lower": half(90, 189), "unasked": prior_of(true_depth)}

    def confirmed(*names: str) -> float:
        component = build(ConsistencyDense, prior=names, stride=3)
        points = component.initialize(as_it_is(scene), priors)
        assert distance_to_surface(scene, points).quantile(0.999) < 0.02
        return float(points.facts["views"][scene.train[1].name]["consistent"])

    upper, lower = confirmed("upper"), confirmed("lower")
    assert min(upper, lower) > 0.2
    assert confirmed("upper", "lower") == pytest.approx(upper + lower, abs=0.01)
    with pytest.raises(PluginError, match="no prior named 'middle'"):
        confirmed("upper", "middle")


@pytest.mark.proof
def test_three_real_photographs() -> None:
    scene = build(LLFFScene, path=data_folder("llff_fern")).load()
    points = build(
        ConsistencyDense,
        max_reprojection_error=2.0,
        max_depth_error=0.05,
        min_component=100,
        stride=3,
        sigma=0.5,
        **COMPLETE,
    ).initialize(as_it_is(scene), {"plane_sweep": build(PlaneSweep)})
    assert 20_000 < len(points) < 90_000
    for facts in points.facts["views"].values():
        assert facts["consistent"] > 0.55
        assert facts["consistent"] + facts["filled"] > 0.95
    assert scene.points is not None
    distance, _ = KDTree(points.positions.numpy()).query(scene.points.positions.numpy())
    assert np.median(distance) < 0.01 * scene.bounds[1]


def test_hand_on_depth_returns_the_confirmed_depths(scene: Scene) -> None:
    assert dense(scene, stride=4).maps == {}
    points = dense(scene, stride=4, fill=True, hand_on_depth=True)
    assert list(points.maps) == [view.name for view in scene.train]
    for view in scene.train:
        known = points.maps[view.name]
        confirmed = points.facts["views"][view.name]["consistent"]
        assert float(known.valid.float().mean()) == pytest.approx(confirmed, abs=1e-4)
        assert 0.5 < confirmed < 1
        wrong = (known.depth - true_depth(view))[known.valid].abs()
        assert wrong.quantile(0.99) < 0.02
        assert (known.depth[~known.valid] == 0).all()


def test_hand_on_depth_skips_transparent_pixels(scene: Scene) -> None:
    alpha = torch.ones_like(scene.train[0].image[..., 0])
    alpha[:, :20], alpha[:, 20] = 0, 0.5
    views = tuple(replace(view, alpha=alpha) for view in scene.train)
    points = dense(replace(scene, train=views), stride=4, hand_on_depth=True)
    for known in points.maps.values():
        assert not known.valid[:, :21].any()
        assert (known.depth[:, :21] == 0).all()
        assert known.valid[:, 21:].float().mean() > 0.5


def fan_of_views(widest: float) -> Scene:
    """Four grey views that look at the origin, those at the ends so many degrees apart."""
    turns = (-0.5 * widest, -widest / 6, widest / 6, 0.5 * widest)
    views = [view_of(camera_towards_origin(t), name=f"view{n}") for n, t in enumerate(turns)]
    return Scene("wall", tuple(views), (), (1.0, 10.0))


@pytest.mark.parametrize(("widest", "stays"), [(30.0, True), (44.0, False)])
def test_surrounding_views_outvote_a_chance_agreement(widest: float, stays: bool) -> None:
    def depth_of(view: View) -> Tensor:
        wall = plane_depth(view.camera, 0.0)
        if view.name not in ("view1", "view2"):
            return wall
        plate = plane_depth(view.camera, -1.5)
        points = view.camera.unproject(*view.camera.pixel_centers(), plate.double())
        return torch.where(points[..., 0].abs() < 0.2, plate, wall)

    points = dense(
        fan_of_views(widest),
        depth_of,
        min_consistent=1,
        max_depth_error=0.05,
    )
    kind = "forward-facing" if stays else "surrounding"
    assert points.facts["scene_kind"] == kind
    before = points.positions[:, 2] < -1.4
    assert (int(before.sum()) > 100) == stays
    assert int((~before).sum()) > 1000


@pytest.mark.parametrize(("widest", "changes"), [(30.0, True), (44.0, False)])
def test_planes_are_continued_if_all_cameras_look_the_same_way(
    widest: float, changes: bool
) -> None:
    def depth_of(view: View) -> Tensor:
        depth = plane_depth(view.camera, 0.0)
        height, width = (size // 3 for size in depth.shape)
        depth[height:-height, width:-width] = 0
        return depth

    plain, planes = (
        dense(
            fan_of_views(widest),
            depth_of,
            min_consistent=1,
            max_depth_error=0.05,
            fill=True,
            fill_planes=wanted,
        )
        for wanted in (False, True)
    )
    assert torch.equal(plain.positions, planes.positions) != changes


def test_each_kind_of_scene_can_have_its_own_priors() -> None:
    priors = {
        f"wall at {z}": prior_of(lambda view, z=z: plane_depth(view.camera, z))  # type: ignore[misc]
        for z in (0.0, 1.0, 2.0)
    }
    component = build(
        ConsistencyDense,
        prior={
            "forward-facing": "wall at 0.0",
            "object": "wall at 1.0",
            "surrounding": ["wall at 2.0"],
        },
    )

    def found(scene: Scene) -> float:
        return float(component.initialize(as_it_is(scene), priors).positions[:, 2].mean())

    def under_blue(rows: int, scene: Scene) -> Scene:
        image = torch.rand(40, 60, 3, generator=torch.Generator().manual_seed(0))
        image[:rows] = torch.tensor((0.2, 0.3, 0.6))
        return replace(scene, train=tuple(replace(view, image=image) for view in scene.train))

    narrow, wide = fan_of_views(30.0), fan_of_views(44.0)
    assert found(under_blue(0, narrow)) == pytest.approx(0, abs=1e-3)
    assert found(under_blue(20, narrow)) == pytest.approx(1, abs=1e-3)
    assert found(under_blue(0, wide)) == pytest.approx(2, abs=1e-3)


def test_a_mapping_names_priors_for_every_kind_of_scene() -> None:
    with pytest.raises(ValueError, match="object, surrounding"):
        build(ConsistencyDense, prior={"forward-facing": "plane_sweep"})
