from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import open_device
from registry import Context, Scene, SceneError, Settings
from registry.priors import Matches, MatchingPrior
from registry.testing import check
from stereogs_plugins.initializers.two_view import MatchedPoints
from stereogs_plugins.priors.sift_matches import SiftMatches
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, view_of


class FixedMatches(MatchingPrior[Settings]):
    """Four points of a wall at 5, seen 4 pixels apart; the second is 1.5 pixels off, the third 3."""

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        here = torch.tensor([[30.0, 10.0], [31.0, 20.0], [32.0, 30.0], [33.0, 35.0]])
        off = torch.tensor([[-4.0, 0.0], [-4.0, 1.5], [-4.0, 3.0], [-4.0, 0.0]])
        return Matches(here, here + off, torch.tensor([1.0, 0.9, 0.8, 0.3]))


class WallMatches(MatchingPrior[Settings]):
    """A wall at 3 between the cameras of `registry.testing`, 0.4 apart."""

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        height, width = first.shape[:2]
        shift = torch.tensor([4.0 * width / 32, 0.0])  # the focal length grows with the width
        if first[0, 0, 2] < second[0, 0, 2]:
            shift = -shift
        spots = torch.rand(20, 2, generator=torch.Generator().manual_seed(4))
        here = (0.3 + 0.4 * spots) * torch.tensor([width, height])
        return Matches(here, here + shift, torch.ones(20))


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")


def pair() -> Scene:
    colors = torch.arange(40 * 60 * 3).reshape(40, 60, 3) / 7200
    views = (view_of(camera_at(0.0), colors, "a"), view_of(camera_at(0.4), name="b"))
    return Scene("pair", views, (), (1.0, 20.0))


def fixed() -> dict[str, FixedMatches]:
    return {"m": FixedMatches(Settings(), Context("m", 0, open_device()))}


@pytest.mark.parametrize(
    ("settings", "kept"),
    [({}, [0, 1, 3]), ({"max_distance": 1.0}, [0, 3]), ({"min_score": 0.5}, [0, 1])],
)
def test_matches_near_their_epipolar_lines_become_points(
    settings: dict[str, float], kept: list[int]
) -> None:
    scene = pair()
    cloud = build(MatchedPoints, **settings).initialize(scene.for_training(), fixed())
    columns, rows = torch.tensor([30, 31, 32, 33])[kept], torch.tensor([10, 20, 30, 35])[kept]
    wanted = scene.train[0].camera.unproject(
        columns.double(), rows.double(), torch.full((len(kept),), 5.0)
    )
    torch.testing.assert_close(cloud.positions, wanted.float())
    assert torch.equal(cloud.colors, scene.train[0].image[rows, columns])


def test_no_fitting_match_is_an_error() -> None:
    scene = replace(pair(), bounds=(6.0, 20.0))  # the wall at 5 is before the scene
    with pytest.raises(SceneError, match="no match between the 2"):
        build(MatchedPoints).initialize(scene.for_training(), fixed())


def test_sift_gives_points_on_the_rooms_surfaces(procedural_room: Scene) -> None:
    known = procedural_room.for_training()
    small = replace(known, train=known.train[:2])
    cloud = build(MatchedPoints).initialize(small, {"matches": build(SiftMatches)})
    view = procedural_room.train[0]
    assert view.depth is not None
    u, v, z = view.camera.project(cloud.positions)
    wrong = (z / view.depth[v.long(), u.long()] - 1).abs()
    assert len(cloud) > 100
    assert wrong.median() < 0.02


def test_it_keeps_the_contract() -> None:
    prior = WallMatches(Settings(), Context("m", 0, open_device()))
    check(MatchedPoints, priors={"m": prior})
