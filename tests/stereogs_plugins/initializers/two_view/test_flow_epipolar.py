from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import open_device
from registry import Context, Scene, SceneError, Settings
from registry.priors import OpticalFlowPrior
from registry.testing import check
from stereogs_plugins.initializers.two_view import (
    FlowEpipolar,
    MatchedPoints,
    stereogs_register_initializers,
)
from stereogs_plugins.priors.dis_flow import DisFlow
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, view_of


class WallFlow(OpticalFlowPrior[Settings]):
    """Flow of a wall whose depth each second view may take to be another, and an error across."""

    scene: Scene
    depth: Sequence[float]
    across = 0.0

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        views = self.scene.train
        here = next(v for v in views if v.image is first)
        index = next(k for k, v in enumerate(views) if v.image is second)
        u, v = here.camera.pixel_centers()
        z = torch.full_like(u, self.depth[index])
        there = views[index].camera.project(here.camera.unproject(u, v, z))
        return torch.stack([there[0] - u, there[1] - v + self.across], dim=2).float()


class StillFlow(OpticalFlowPrior[Settings]):
    """A wall at 3 between cameras 0.4 apart with a focal length of 30, as the suite's are."""

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        flow = torch.zeros(*first.shape[:2], 2)
        shift = 4.0 * first.shape[1] / 32  # the focal length grows with the width
        flow[..., 0] = -shift if first[0, 0, 2] < second[0, 0, 2] else shift
        return flow


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")


def row(*places: float) -> Scene:
    """Cameras at these places along x, with photographs of one colour each."""
    views = tuple(
        view_of(camera_at(x), torch.full((40, 60, 3), 0.2 + 0.1 * k), f"v{k}")
        for k, x in enumerate(places)
    )
    return Scene("row", views, (), (1.0, 20.0))


def flow_of(scene: Scene, *depth: float, across: float = 0.0) -> WallFlow:
    prior = WallFlow(Settings(), Context("flow", 0, open_device()))
    prior.scene, prior.depth, prior.across = scene, depth, across
    return prior


def test_both_are_registered_and_flow_epipolar_keeps_the_contract() -> None:
    assert offered(stereogs_register_initializers) == {
        "flow_epipolar": FlowEpipolar,
        "matched_points": MatchedPoints,
    }
    check(FlowEpipolar, priors={"flow": StillFlow(Settings(), Context("f", 0, open_device()))})


def test_points_follow_the_flow_and_have_the_photographs_colours() -> None:
    scene = row(0.0, 0.4)
    cloud = build(FlowEpipolar).initialize(scene.for_training(), {"f": flow_of(scene, 5.0, 5.0)})
    torch.testing.assert_close(cloud.positions[:, 2], torch.full((len(cloud),), 5.0))
    assert len(cloud) == 2 * 40 * 56  # four columns of each are not in the other image
    torch.testing.assert_close(cloud.colors[0], torch.full((3,), 0.2))
    for name, known in cloud.maps.items():
        assert int(known.valid.sum()) == 40 * 56, name
        torch.testing.assert_close(known.depth[known.valid], torch.full((40 * 56,), 5.0))
        assert (known.depth[~known.valid] == 0).all()


def test_flow_beyond_max_distance_gives_no_points() -> None:
    scene = row(0.0, 0.4)
    for across, found in ((0.9, True), (1.1, False)):
        prior = {"f": flow_of(scene, 5.0, 5.0, across=across)}
        component = build(FlowEpipolar, max_distance=1.0)
        if found:
            assert len(component.initialize(scene.for_training(), prior)) > 3000
        else:
            with pytest.raises(SceneError, match="no flow between the 2"):
                component.initialize(scene.for_training(), prior)


def test_the_nearest_neighbour_wins_or_the_least_sensitive() -> None:
    """From the first of three, the near camera says 5, the far one 8: a longer baseline is surer."""
    scene = row(0.0, 0.2, 0.6)
    prior = {"f": flow_of(scene, 5.0, 5.0, 8.0)}
    middle = {}
    for blend in ("nearest_valid", "min_sensitivity"):
        maps = build(FlowEpipolar, blend=blend).initialize(scene.for_training(), prior).maps
        middle[blend] = float(maps["v0"].depth[20, 30])
    assert middle == {
        "nearest_valid": pytest.approx(5.0),
        "min_sensitivity": pytest.approx(8.0),
    }
    one = build(FlowEpipolar, blend="min_sensitivity", neighbours=1)
    maps = one.initialize(scene.for_training(), prior).maps
    assert float(maps["v0"].depth[20, 30]) == pytest.approx(5.0)


def test_stride_reduces_points_but_not_the_maps() -> None:
    scene = row(0.0, 0.4)
    prior = {"f": flow_of(scene, 5.0, 5.0)}
    full, thin = (
        build(FlowEpipolar, stride=k).initialize(scene.for_training(), prior) for k in (1, 2)
    )
    assert len(full) == 4 * len(thin)
    assert torch.equal(full.maps["v0"].depth, thin.maps["v0"].depth)


def test_depths_beyond_the_bounds_are_dropped_and_one_view_is_an_error() -> None:
    scene = row(0.0, 0.4)
    with pytest.raises(SceneError, match="no flow"):
        build(FlowEpipolar).initialize(scene.for_training(), {"f": flow_of(scene, 50.0, 50.0)})
    alone = replace(scene, train=scene.train[:1])
    with pytest.raises(SceneError, match="two training views"):
        build(FlowEpipolar).initialize(alone.for_training(), {"f": flow_of(scene, 5.0, 5.0)})


def test_dis_flow_gives_the_rooms_depth(procedural_room: Scene) -> None:
    known = procedural_room.for_training()
    small = replace(known, train=known.train[:2])
    cloud = build(FlowEpipolar).initialize(small, {"flow": build(DisFlow)})
    view = procedural_room.train[0]
    found = cloud.maps[view.name]
    assert view.depth is not None
    wrong = ((found.depth - view.depth).abs() / view.depth)[found.valid]
    assert found.valid.float().mean() > 0.3
    assert wrong.median() < 0.02
