"""PatchMatch on scenes with known depth, and its errors."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from registry import Scene
from registry.priors import DepthMap
from registry.testing import tiny_scene
from stereogs_plugins.priors.patch_match import PatchMatchPrior, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered


@pytest.fixture(scope="module")
def room(procedural_room: Scene) -> Scene:
    """Three training views of the ray-cast room with exact depth."""
    return replace(procedural_room, test=())


@pytest.fixture(scope="module")
def answers(room: Scene) -> list[DepthMap]:
    """Results for the room with default settings."""
    return build(PatchMatchPrior).depths(room.train, room.bounds)


def test_the_plugin_registers_it() -> None:
    assert offered(stereogs_register_priors) == {"patch_match": PatchMatchPrior}


def test_the_depth_of_a_room_is_found(room: Scene, answers: list[DepthMap]) -> None:
    """The outer views see a tenth of the room alone; the middle one sees little alone."""
    errors = []
    for answer, view in zip(answers, room.train, strict=True):
        assert view.depth is not None
        assert answer.valid.float().mean() > 0.95
        known = answer.valid & (view.depth > 0)
        errors.append(((answer.depth - view.depth).abs() / view.depth)[known])
    for relative, least, middle in ((0.01, 0.77, 0.85), (0.03, 0.82, 0.91)):
        shares = [float((error < relative).float().mean()) for error in errors]
        assert min(shares) > least
        assert shares[1] > middle


def test_confidence_separates_right_from_wrong_depths(room: Scene, answers: list[DepthMap]) -> None:
    answer, truth = answers[1], room.train[1].depth
    assert truth is not None
    right = ((answer.depth - truth).abs() < 0.05 * truth) & answer.valid
    wrong = ~right & answer.valid
    assert answer.confidence[right].mean() > 1.3 * answer.confidence[wrong].mean()


def test_the_seed_of_the_run_does_not_matter() -> None:
    """A prior's answers are kept for all runs."""
    scene = tiny_scene()
    first, second = (
        build(PatchMatchPrior, seed).depths(scene.train, scene.bounds) for seed in (0, 1)
    )
    for one, other in zip(first, second, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.confidence, other.confidence)


def test_pixels_without_a_match_are_invalid() -> None:
    scene = tiny_scene()
    views = [replace(view, image=torch.full_like(view.image, 0.4)) for view in scene.train]
    assert not any(a.valid.any() for a in build(PatchMatchPrior).depths(views, scene.bounds))
    assert all(a.valid.any() for a in build(PatchMatchPrior).depths(scene.train, scene.bounds))
