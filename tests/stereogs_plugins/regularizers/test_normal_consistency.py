"""`normal_consistency` and `prior_normals`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import GaussianModel, Gaussians, Rendering, open_device
from registry import PluginError, Regularizer, Scene, Settings, Step
from registry.priors import MonocularDepth, MonocularDepthPrior, NormalPrior
from registry.testing import check, step_of, tiny_scene
from registry.toolkit.views import depth_normals
from stereogs_plugins.regularizers.normal_consistency import NormalConsistency, PriorNormals
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.host import (
    HostSettings,
    Item,
    Parts,
    TrainingSettings,
    assemble,
    pipeline_item,
    pipeline_of,
)
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.regularizers.toy_normals import SKY, Wall


class WallWithDepth(MonocularDepthPrior[Settings]):
    """The same, beside depth."""

    def estimate(self, image: Tensor) -> MonocularDepth:
        return MonocularDepth(image.mean(dim=2), normals=build(Wall).estimate(image))


class DepthAlone(MonocularDepthPrior[Settings]):
    def estimate(self, image: Tensor) -> Tensor:
        return image.mean(dim=2)


def before_a_wall(*quaternion: float) -> tuple[Step, GaussianModel]:
    """Return a step in front of a wall of discs that are thin along their own z axis, and its model."""
    u, v = torch.meshgrid(torch.linspace(-3, 3, 30), torch.linspace(-3, 3, 30), indexing="xy")
    means = torch.stack([u, v, torch.full_like(u, 3.0)], dim=2).reshape(-1, 3)
    scales = torch.tensor([0.3, 0.3, 0.01]).repeat(900, 1)
    turned = torch.tensor([quaternion]).repeat(900, 1)
    gaussians = Gaussians.from_points(means, means, scales, torch.full((900,), 0.9), 0, turned)
    model, scene = GaussianModel(gaussians, open_device()), tiny_scene()
    rendering = model.render(scene.train[0].camera)
    return step_of(model, scene, rendering=rendering), model


def test_both_keep_the_contract() -> None:
    check(NormalConsistency)
    for prior in (Wall, WallWithDepth):
        check(prior)
        check(PriorNormals, priors={"normals": build(prior)})


def test_gaussians_that_lie_in_the_surface_cost_nothing_and_others_turn_into_it() -> None:
    step, _ = before_a_wall(1.0, 0, 0, 0)
    assert float(build(NormalConsistency).loss(step).detach()) < 1e-3
    step, model = before_a_wall(0.96, 0.28, 0, 0)  # half of 32.5 degrees about the x axis
    loss = build(NormalConsistency).loss(step)
    assert float(loss.detach()) > 0.05
    loss.backward()
    assert float(model.gradient("quaternions")[:, 1].sum()) > 0


def test_a_prior_counts_where_it_knows_the_normal() -> None:
    step, _ = before_a_wall(1.0, 0, 0, 0)
    view = step.view
    v = torch.arange(24.0)[:, None].expand(24, 32)
    slope = 3 + 0.1 * v * (v < SKY - 1)  # only the sky is not flat
    rendering = Rendering(view.image, slope, torch.ones(24, 32))
    step.rendered(lambda: rendering)
    for prior in (Wall, WallWithDepth):
        given = replace(step, priors={"normals": build(prior)})
        assert 0 <= float(build(PriorNormals).loss(given)) < 0.01
    tilted = Rendering(view.image, 3 + 0.1 * v, torch.ones(24, 32))
    step.rendered(lambda: tilted)
    rows = depth_normals(tilted, view.camera)[SKY:-1, 1:-1]
    expected = float((1 + rows[..., 2]).mean())
    given = replace(step, priors={"depth": build(DepthAlone), "normals": build(Wall)})
    assert float(build(PriorNormals).loss(given)) == pytest.approx(expected, rel=1e-4)


def test_depth_without_normals_is_refused() -> None:
    step, _ = before_a_wall(1.0, 0, 0, 0)
    with pytest.raises(PluginError, match="'under test' estimates depth without normals"):
        build(PriorNormals).loss(replace(step, priors={"depth": build(DepthAlone)}))


@cache
def room() -> Scene:
    return build(ProceduralScene, width=96, height=72, test_views=0).load().in_frame()


class TrueNormals(NormalPrior[Settings]):
    """Those of the room's true depth."""

    def estimate(self, image: Tensor) -> Tensor:
        view = next(view for view in room().train if torch.equal(view.image, image))
        assert view.depth is not None
        return depth_normals(Rendering(image, view.depth, torch.ones_like(view.depth)), view.camera)


def weighted(component: type[Regularizer[Any]], weight: float) -> Item:
    item = pipeline_item(component, component.Settings(), "term")
    return replace(item, host=HostSettings(use="term", weight=weight))


def depth_error(items: list[Item], iterations: int) -> float:
    """Train in the room; return the mean relative error of depth in the training views."""
    training = TrainingSettings(iterations=iterations, sh_degree=0)
    points = room().points
    assert points is not None
    trainer = assemble(Parts(pipeline_of(items, training), open_device()), room(), points)
    list(trainer.run())
    errors = []
    for view in room().train:
        assert view.depth is not None
        with torch.no_grad():
            seen = trainer.model.render(view.camera)
        errors.append(float(((seen.depth / seen.alpha - view.depth) / view.depth).abs().mean()))
    return sum(errors) / len(errors)


def test_true_normals_improve_the_depth_of_the_room() -> None:
    truth: Any = pipeline_item(TrueNormals, Settings(), "truth")
    alone, with_normals = (
        depth_error(items, 150) for items in ([], [truth, weighted(PriorNormals, 0.1)])
    )
    assert with_normals < 0.85 * alone


@pytest.mark.proof
def test_gaussians_in_the_surface_improve_the_depth_of_the_room() -> None:
    alone, consistent = (
        depth_error(items, 600) for items in ([], [weighted(NormalConsistency, 0.02)])
    )
    assert consistent < 0.97 * alone
