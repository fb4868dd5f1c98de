"""The prior `sift_matches`: points of shifted and turned images are found again."""

from __future__ import annotations

import torch

from registry import Scene
from registry.testing import check
from stereogs_plugins.priors.sift_matches import SiftMatches, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered


def test_it_is_registered_and_keeps_the_contract() -> None:
    assert offered(stereogs_register_priors) == {"sift_matches": SiftMatches}
    check(SiftMatches)


def test_points_of_a_crop_are_matched(procedural_room: Scene) -> None:
    image = procedural_room.train[0].image
    cut = image[9:, 14:].contiguous()
    found = build(SiftMatches).matches(image, cut)
    assert len(found.scores) > 100
    wrong = (found.first - found.second - torch.tensor([14.0, 9.0])).norm(dim=1)
    assert (wrong < 0.5).float().mean() > 0.95
    assert found.scores.median() > 0.95


def test_matches_lie_on_epipolar_lines(procedural_room: Scene) -> None:
    first, second = procedural_room.train[:2]
    found = build(SiftMatches).matches(first.image, second.image)
    assert len(found.scores) > 20
    assert first.depth is not None
    column, row = found.first.long().unbind(dim=1)
    depth = first.depth[row, column]
    u, v, _ = second.camera.project(
        first.camera.unproject(found.first[:, 0], found.first[:, 1], depth)
    )
    wrong = (torch.stack([u, v], dim=1) - found.second).norm(dim=1)
    assert (wrong < 1.5).float().mean() > 0.7


def test_a_strict_ratio_keeps_fewer_and_flat_images_have_none(procedural_room: Scene) -> None:
    first, second = procedural_room.train[:2]
    usual = build(SiftMatches).matches(first.image, second.image)
    strict = build(SiftMatches, max_ratio=0.5).matches(first.image, second.image)
    assert 0 < len(strict.scores) < len(usual.scores)
    few = build(SiftMatches, max_features=50).matches(first.image, second.image)
    assert len(few.scores) <= 60
    flat = torch.full((40, 50, 3), 0.5)
    assert len(build(SiftMatches).matches(first.image, flat).scores) == 0
