from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from core_rasterizer import Model, open_device
from registry import PluginError, Settings, Step
from registry.priors import MonocularDepth, MonocularDepthPrior
from registry.testing import check, step_of, tiny_scene
from registry.toolkit.views import SOLID, virtual_views
from stereogs_plugins.regularizers.pearson_depth import PearsonDepth, correlation
from tests.host import PARAMETERS, TrainingSettings, initial_gaussians, new_model
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.regularizers.monocular import Brightness, DifferentiableBrightness

DEPTH = torch.tensor([[1.0, 2.0, 4.0], [3.0, 8.0, 5.0]])
INVERSE = torch.tensor([[30.0, 10.0, 2.0], [7.0, 1.0, 4.0]])


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def moment(prior: MonocularDepthPrior[Any]) -> tuple[Step, Model]:
    scene, settings = tiny_scene(), TrainingSettings(sh_degree=0)
    assert scene.points is not None
    model = new_model(initial_gaussians(scene.points, settings), settings, open_device())
    camera = scene.train[0].camera
    return step_of(model, scene, rendering=model.render(camera), priors={"mono": prior}), model


@pytest.mark.parametrize("views", ["training", "box", "between", "sphere"])
def test_it_keeps_the_contract(views: str) -> None:
    check(PearsonDepth, priors={"mono": build(Brightness)}, views=views, offset=200.0)


def test_correlation_is_numpys_and_its_gradient_that_of_finite_differences() -> None:
    first, second = random(4, 5), random(4, 5) ** 2
    expected = np.corrcoef(first.ravel(), second.ravel())[0, 1]
    assert float(correlation(first, second)) == pytest.approx(expected)
    assert float(correlation(first, 3 - 2 * first)) == pytest.approx(-1)
    torch.autograd.gradcheck(correlation, (first.requires_grad_(), second.requires_grad_()))


def test_what_is_constant_agrees_with_everything_and_pulls_at_nothing() -> None:
    varied = random(4, 5).float().requires_grad_()
    flat = torch.full((4, 5), 12.3456789)
    for pair in ((varied, flat), (flat, varied)):
        assert float(correlation(*pair).detach()) == 1
        assert not correlation(*pair).requires_grad


def fitted(
    offset: float | None,
    inverse: torch.Tensor | MonocularDepth = INVERSE,
    iteration: int = 10,
    alpha: torch.Tensor | None = None,
    **s: int,
) -> float:
    """The term for the depth and inverse depth above."""

    class Known(MonocularDepthPrior[Settings]):
        def estimate(self, image: torch.Tensor) -> torch.Tensor | MonocularDepth:
            return inverse

    step, model = moment(build(Known))
    view = replace(step.view, image=torch.rand(2, 3, 3), alpha=alpha)
    step = replace(step, sample=replace(step.sample, view=view))
    step = replace(step, iteration=iteration)
    rendering = replace(model.render(step.view.camera), depth=DEPTH)
    step.rendered(lambda: rendering)
    return float(build(PearsonDepth, offset=offset, **s).loss(step))


def test_the_better_of_two_forms_counts() -> None:
    """FSGS's own two forms, on a small array: corr(-m, z) and corr(1 / (m + 200), z)."""
    z, m = DEPTH.ravel().numpy(), INVERSE.ravel().numpy()
    plain = 1 - np.corrcoef(-m, z)[0, 1]
    for offset in (200.0, 1.0):
        reciprocal = 1 - np.corrcoef(1 / (m + offset), z)[0, 1]
        assert reciprocal < plain
        assert fitted(offset) == pytest.approx(reciprocal, rel=1e-4)
    assert fitted(None) == pytest.approx(plain, rel=1e-4)


def test_of_an_object_before_nothing_only_the_object_counts() -> None:
    alpha = torch.tensor([[0.0, 1.0, 1.0], [1.0, 0.5, 1.0]])
    z, m = DEPTH[alpha == 1].numpy(), INVERSE[alpha == 1].numpy()
    assert fitted(None, alpha=alpha) == pytest.approx(1 - np.corrcoef(-m, z)[0, 1], rel=1e-4)
    best = 1 - max(np.corrcoef(answer, z)[0, 1] for answer in (-m, 1 / (m + 1)))
    assert fitted(1.0, alpha=alpha) == pytest.approx(best, rel=1e-4)
    assert fitted(1.0, INVERSE - 4, alpha=(INVERSE > 4).float()) > 0  # the offset suits what counts
    assert fitted(1.0, alpha=torch.zeros(2, 3)) == 0


def test_only_valid_pixels_count_and_what_is_unknown_of_the_values_decides_the_form() -> None:
    valid = torch.tensor([[True, True, True], [False, True, True]])
    z, m = DEPTH[valid].numpy(), INVERSE[valid].numpy()
    partly = MonocularDepth(INVERSE, valid=valid)
    assert fitted(None, partly) == pytest.approx(1 - np.corrcoef(-m, z)[0, 1], rel=1e-4)
    assert fitted(1.0, MonocularDepth(INVERSE, valid=torch.zeros(2, 3))) == 0
    for exact in (
        MonocularDepth(3 / DEPTH, ambiguity="scale"),
        MonocularDepth(3 * DEPTH - 2, inverse=False),
    ):
        assert fitted(200.0, exact) == pytest.approx(0, abs=1e-6)
    assert fitted(None, 3 / DEPTH) > 0.01


def test_in_virtual_views_of_an_object_what_is_rendered_solid_counts() -> None:
    step, model = moment(build(Brightness))
    scene = step.scene
    model.write("opacity_logits", torch.full_like(model.read("opacity_logits"), 7.0))
    views = tuple(replace(view, alpha=torch.ones(view.image.shape[:2])) for view in scene.train)
    around = replace(step, scene=replace(scene, train=views))
    drawn = virtual_views.draw("sphere", scene, build(PearsonDepth, views="sphere").generator)
    rendered = model.render(drawn)
    solid = rendered.alpha > SOLID
    assert solid.any()
    assert not solid.all()
    inverse = build(Brightness).inverse_depth(rendered.rgb.clamp(0, 1))
    expected = 1 - correlation(-inverse[solid], rendered.depth[solid])
    found = build(PearsonDepth, views="sphere").loss(around)
    assert float(found.detach()) == pytest.approx(float(expected.detach()), rel=1e-5)


def test_an_offset_that_is_too_small_is_refused() -> None:
    with pytest.raises(PluginError, match="has the minimum -3"):
        fitted(1.0, INVERSE - 4)


def test_the_ramp_of_fsgs() -> None:
    whole = fitted(None)
    for iteration, factor in ((2001, 1 / 500), (2250, 0.5), (2500, 1), (9000, 1)):
        ramped = fitted(None, iteration=iteration, ramp_start=2000, ramp_length=500)
        assert ramped == pytest.approx(factor * whole, rel=1e-5)


def test_a_photograph_is_asked_about_once_and_virtual_views_each_time() -> None:
    prior = build(Brightness)
    step, _ = moment(prior)
    training = build(PearsonDepth)
    for _ in range(3):
        training.loss(step)
    assert prior.asked == 1
    virtual = build(PearsonDepth, views="box")
    values = [float(virtual.loss(step).detach()) for _ in range(3)]
    assert prior.asked == 4
    assert len(set(values)) == 3


@pytest.mark.parametrize("prior", [Brightness, DifferentiableBrightness])
def test_colours_feel_it_only_through_a_differentiable_prior(prior: type[Brightness]) -> None:
    step, model = moment(build(prior))
    build(PearsonDepth, views="between").loss(step).backward()
    moved = {name: bool(model.gradient(name).any()) for name in PARAMETERS}
    assert moved["means"]
    assert moved["opacity_logits"]
    assert moved["sh"] == prior.differentiable


def test_confidence_is_the_weight_of_a_pixel() -> None:
    confidence = torch.tensor([[0.2, 1.0, 0.5], [0.0, 0.9, 0.1]])
    covariance = np.cov(-INVERSE.ravel(), DEPTH.ravel(), aweights=confidence.ravel())
    expected = 1 - covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert fitted(None, MonocularDepth(INVERSE, confidence=confidence)) == pytest.approx(expected)
    even = MonocularDepth(INVERSE, confidence=torch.full((2, 3), 0.3))
    assert fitted(200.0, even) == pytest.approx(fitted(200.0), rel=1e-4)
    assert fitted(1.0, MonocularDepth(INVERSE, confidence=torch.zeros(2, 3))) == 0
