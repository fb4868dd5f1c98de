"""Support, coverage and the combination, on scenes whose answers are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry import PluginError
from registry.confidence import ConfidenceEstimator, Trained
from registry.testing import check, tiny_scene
from registry.toolkit.views import gathered
from stereogs_plugins.confidence.estimators import Calibrated, Coverage, Fisher, Support
from stereogs_plugins.confidence.estimators.calibrated import (
    CalibratedConfidence,
    probability_of,
)
from stereogs_plugins.confidence.estimators.painted import Painted
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.confidence.trained import small


def wall(depth: float = 3.0, width: float = 4.0) -> Gaussians:
    """An opaque wall at z = depth, of small grey Gaussians."""
    side = torch.linspace(-width / 2, width / 2, int(width * 20))
    x, y = torch.meshgrid(side, side, indexing="ij")
    positions = torch.stack([x, y, torch.full_like(x, depth)], dim=2).reshape(-1, 3)
    count = len(positions)
    sizes, opacities = torch.full((count,), 0.06), torch.full((count,), 0.95)
    return Gaussians.from_points(positions, torch.full((count, 3), 0.5), sizes, opacities, 0)


def trained_with(gaussians: Gaussians) -> Trained:
    model = GaussianModel(gaussians, open_device())
    return replace(small(), model=model.reader())


def moved(camera: Camera, distance: float) -> Camera:
    return camera.shifted_right(distance)


def test_painting_and_gathering_agree() -> None:
    trained = small()
    camera = trained.scene.train[0].camera
    image = torch.rand(camera.height, camera.width, generator=torch.Generator().manual_seed(0))
    values = torch.rand(trained.model.count, 5, generator=torch.Generator().manual_seed(1))
    painted = Painted(trained.model, values).render(camera)
    sums, light = gathered(trained.model, [(camera, image)])
    assert painted.shape == (camera.height, camera.width, 5)
    for k in range(5):
        assert float((painted[..., k] * image).sum()) == pytest.approx(
            float(sums @ values[:, k]), rel=1e-4
        )
    alpha = trained.model.render(camera).alpha
    assert float(light.sum()) == pytest.approx(float(alpha.sum()), rel=1e-4)


def test_support_is_the_share_of_light_from_confirmed_points() -> None:
    every = torch.ones(60, dtype=torch.bool)
    camera = small().scene.train[0].camera
    sure = small(kinds={"confirmed": every})
    alpha = sure.model.render(camera).alpha
    torch.testing.assert_close(build(Support).estimate(sure).of(camera), alpha)
    guessed = small(kinds={"confirmed": ~every, "filled": every})
    assert not build(Support).estimate(guessed).of(camera).any()


def test_support_needs_kinds() -> None:
    with pytest.raises(PluginError, match="does not mark confirmed"):
        build(Support).estimate(small())


def test_a_wall_that_both_cameras_see_is_covered_and_what_is_beside_their_images_is_not() -> None:
    trained = trained_with(wall(width=8.0))
    camera = tiny_scene().test[0].camera
    confidence = build(Coverage).estimate(trained)
    middle = confidence.of(camera)[8:16, 12:20]
    assert float(middle.min()) > 0.8
    beside = confidence.of(moved(camera, 3.0))[:, -4:]
    assert float(beside.max()) == 0


def test_what_is_occluded_for_the_training_cameras_is_not_covered() -> None:
    front, back = wall(2.0, 1.0), wall(4.0, 8.0)
    both = Gaussians(**{k: torch.cat([v, vars(back)[k]]) for k, v in vars(front).items()})
    camera = tiny_scene().test[0].camera
    behind = camera.shifted_right(0.0)
    pose = behind.world_to_camera.clone()
    pose[2, 3] -= 2.5  # past the front wall
    nearer = replace(behind, world_to_camera=pose)
    seen = build(Coverage).estimate(trained_with(back)).of(nearer)
    hidden = build(Coverage).estimate(trained_with(both)).of(nearer)
    assert float(seen[10:14, 14:18].min()) > 0.5
    assert float(hidden[10:14, 14:18].max()) == 0


def test_the_combination_is_a_probability_and_lower_beside_the_photographs() -> None:
    trained = trained_with(wall(width=8.0))
    confidence = build(Calibrated).estimate(trained)
    camera = tiny_scene().test[0].camera
    here, beside = confidence.of(camera), confidence.of(moved(camera, 3.0))
    assert here.shape == (camera.height, camera.width)
    assert 0 < float(beside.mean()) < float(here.mean()) < 1
    assert confidence.gain(moved(camera, 3.0)) > confidence.gain(camera)


def test_a_hole_is_a_guess_unless_the_photographs_show_such_a_background() -> None:
    in_a_room = trained_with(wall(width=1.0))
    black = [replace(v, image=torch.zeros_like(v.image)) for v in in_a_room.scene.train]
    scene = replace(in_a_room.scene, train=tuple(black))
    camera = tiny_scene().test[0].camera
    both = [
        CalibratedConfidence(trained).evidence(camera)
        for trained in (in_a_room, replace(in_a_room, scene=scene))
    ]
    hole, background = (torch.as_tensor(evidence.hole) for evidence in both)
    assert float(hole.max()) > 0.9
    assert float(hole.min()) < 0.1
    assert not background.any()


def test_the_angle_is_that_to_the_nearest_ray_of_a_training_camera() -> None:
    trained = trained_with(wall(width=8.0))
    camera = trained.scene.train[0].camera
    same, beside = (
        torch.as_tensor(CalibratedConfidence(trained).evidence(c).angle).expm1().mean()
        for c in (camera, moved(camera, 1.0))
    )
    assert float(same) < 0.1
    assert 5 < float(beside) < 20


@pytest.mark.parametrize("estimator", [Calibrated, Coverage, Fisher, Support])
def test_it_keeps_the_contract(estimator: type[ConfidenceEstimator[Any]]) -> None:
    check(estimator)


def test_errors_have_an_exponential_distribution() -> None:
    torch.testing.assert_close(
        probability_of(torch.tensor([0.1, 1e-9])), torch.tensor([0.632121, 1.0])
    )
