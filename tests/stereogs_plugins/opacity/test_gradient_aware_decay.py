from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from core_rasterizer import GaussianModel, Gaussians
from registry import OpacityUpdate, Step
from stereogs_plugins.opacity.gradient_aware_decay import (
    GradientAwareDecay,
    stereogs_register_opacity_policies,
)
from tests.host import OPACITY_MARGIN
from tests.stereogs_plugins.building import build, moment_with, offered, some_gaussians, step_with


def gaussians() -> Gaussians:
    """Two in view, and one far outside, which gets no gradient."""
    scene = some_gaussians([0.05, 0.2, 0.1], [0.3, 0.8, 0.5])
    scene.means[2, 0] = 100
    return scene


def updated(decay: GradientAwareDecay, step: Step) -> OpacityUpdate:
    """The policy's answer, which must not be None."""
    update = decay.update(step)
    assert update is not None
    return update


def test_is_offered_as_gradient_aware_decay() -> None:
    assert offered(stereogs_register_opacity_policies) == {
        "gradient_aware_decay": GradientAwareDecay
    }


@pytest.mark.parametrize("wrt", ["activated", "logit"])
def test_is_the_papers_formula(wrt: str) -> None:
    step = step_with(gaussians())
    update = updated(build(GradientAwareDecay, wrt=wrt), step)
    opacities = torch.tensor([0.3, 0.8, 0.5])
    gradient = step.model.gradient("opacity_logits").abs()
    if wrt == "activated":
        gradient = gradient / (opacities * (1 - opacities))
    beta = gradient / gradient.mean()
    expected = (1 - 0.01 * torch.exp(-0.5 * beta)) * opacities
    torch.testing.assert_close(update.opacities, expected)
    assert update.opacities[2] == pytest.approx(0.99 * 0.5)
    assert not update.reset_moments


def test_the_activated_gradient_is_that_of_the_opacity_itself() -> None:
    """Finite differences of the loss in one opacity, against what `wrt: activated` divides out."""
    step = step_with(gaussians())
    chain = step.model.gradient("opacity_logits")[1] / (0.8 * 0.2)

    def loss(opacity: float) -> float:
        changed = gaussians()
        changed.opacity_logits[1] = math.log(opacity / (1 - opacity))
        other = step_with(changed)
        return float(((other.rendering.rgb.detach() - other.view.image).double() ** 2).mean())

    slope = (loss(0.81) - loss(0.79)) / 0.02
    assert float(chain) == pytest.approx(slope, rel=2e-2)


@pytest.mark.parametrize(
    ("function", "factors"),
    [
        ("exp_beta", [1 - 0.1, 1 - 0.1 * math.exp(-0.5), 1 - 0.1 * math.exp(-2)]),
        ("exp_g", [1 - 0.1, 1 - 0.1 * math.exp(-0.05), 1 - 0.1 * math.exp(-0.2)]),
        ("step", [0.9, 1.0, 1.0]),
        ("linear", [0.9, 0.95, 1.0]),
        ("constant", [0.9, 0.9, 0.9]),
    ],
)
def test_the_functions_that_the_paper_compares(function: str, factors: list[float]) -> None:
    decay = build(GradientAwareDecay, function=function, base=0.9)
    relative = torch.tensor([0.0, 1.0, 4.0])
    torch.testing.assert_close(1 - decay.decay(relative / 10, relative), torch.tensor(factors))


def test_contributing_spares_what_this_view_does_not_show() -> None:
    update = updated(build(GradientAwareDecay, scope="contributing"), step_with(gaussians()))
    assert update.opacities[2] == pytest.approx(0.5)
    assert update.opacities[0] < 0.3


@pytest.mark.parametrize(("full_views", "factor"), [(None, 1.0), (3, 1.0), (2, 2 / 3), (1, 1 / 3)])
def test_more_views_than_full_views_decay_less(full_views: int | None, factor: float) -> None:
    step = step_with(gaussians())
    view = step.scene.train[0]
    step = replace(step, scene=replace(step.scene, train=(view, view, view)))
    before = torch.tensor([0.3, 0.8, 0.5])
    full = updated(build(GradientAwareDecay), step).opacities
    less = updated(build(GradientAwareDecay, full_views=full_views), step).opacities
    torch.testing.assert_close(before - less, factor * (before - full), rtol=1e-4, atol=1e-8)
    assert torch.equal(less, full) == (factor == 1)


def test_without_any_gradient_all_decay_by_the_base() -> None:
    hidden = gaussians()
    hidden.means[:, 2] = -5
    update = updated(build(GradientAwareDecay), step_with(hidden))
    torch.testing.assert_close(update.opacities, 0.99 * torch.tensor([0.3, 0.8, 0.5]))


@pytest.mark.parametrize(
    ("function", "slopes"),
    [
        ("exp_beta", [0.99, 1 - 0.01 * math.exp(-0.5), 1 - 0.01 * math.exp(-1)]),
        ("exp_g", [0.99, 1 - 0.01 * math.exp(-0.05), 1 - 0.01 * math.exp(-0.1)]),
        ("step", [0.99, 1.0, 1.0]),
        ("linear", [0.99, 0.995, 1.0]),
        ("constant", [0.99, 0.99, 0.99]),
    ],
)
def test_decay_curves(function: str, slopes: list[float]) -> None:
    """100 iterations at gradients of 0, 1 and 2 times their mean of 0.1."""
    decay = build(GradientAwareDecay, function=function)
    relative = torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64)
    opacities = torch.full_like(relative, 0.8)
    for _ in range(100):
        opacities = (1 - decay.decay(relative / 10, relative)) * opacities
    expected = torch.tensor([0.8 * slope**100 for slope in slopes], dtype=torch.float64)
    torch.testing.assert_close(opacities, expected, rtol=1e-12, atol=0)


def test_a_thousand_decays_without_gradient_are_monotone_and_end_at_the_hosts_margin() -> None:
    hidden = gaussians()
    hidden.means[:, 2] = -5
    step, model = moment_with(hidden)
    decay = build(GradientAwareDecay, base=0.98)
    before = step.model.opacities()
    for _ in range(1000):
        update = updated(decay, step)
        kept = update.opacities.clamp(OPACITY_MARGIN, 1 - OPACITY_MARGIN)
        model.write("opacity_logits", torch.logit(kept))
        after = step.model.opacities()
        assert (after <= before * 1.0001).all()
        before = after
    assert torch.isfinite(step.model.read("opacity_logits")).all()
    torch.testing.assert_close(before, torch.full((3,), OPACITY_MARGIN))


def poison(model: GaussianModel, value: float) -> None:
    """Put a value into the gradient of the first opacity."""
    gradients = model.gradients.rows.read().clone()
    gradients[10, 0] = value
    model.gradients.rows.write(gradients)


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("function", ["exp_beta", "exp_g", "step", "linear", "constant"])
def test_a_gradient_that_is_not_finite_stops_the_decay(function: str, value: float) -> None:
    step, model = moment_with(gaussians())
    logged: dict[str, float] = {}
    step = replace(step, log=logged.__setitem__)
    decay = build(GradientAwareDecay, function=function)
    assert decay.update(step) is not None
    assert logged["opacity_gradient_undefined"] == 0
    poison(model, value)
    assert decay.update(step) is None
    assert logged["opacity_gradient_undefined"] == 1


def test_the_smallest_opacities_keep_their_slope() -> None:
    """The gradients in the opacities themselves are both 1."""
    opacities = torch.tensor([OPACITY_MARGIN, 2 * OPACITY_MARGIN])
    step, model = moment_with(some_gaussians([0.1, 0.1], opacities.tolist()))
    gradients = model.gradients.rows.read().clone()
    gradients[10, :2] = opacities
    model.gradients.rows.write(gradients)
    update = updated(build(GradientAwareDecay, base=0.5), step)
    expected = (1 - 0.5 * math.exp(-0.5)) * opacities
    torch.testing.assert_close(update.opacities, expected, rtol=1e-3, atol=0)


def test_visible_spares_what_touched_no_pixel() -> None:
    step, model = moment_with(gaussians())
    poison(model, 0.0)  # touched, though the loss does not depend on its opacity
    for scope, first in (("visible", 0.99 * 0.3), ("contributing", 0.3)):
        update = updated(build(GradientAwareDecay, scope=scope), step)
        assert update.opacities[0] == pytest.approx(first)
        assert update.opacities[1] < 0.8
        assert update.opacities[2] == pytest.approx(0.5)


def test_quantiles_of_gradient_and_beta() -> None:
    count = 41
    step = step_with(some_gaussians([0.1] * count, [0.4] * count), iteration=75)
    logged: dict[str, float] = {}
    step = replace(step, log=logged.__setitem__)
    build(GradientAwareDecay, wrt="logit").update(step)
    gradient = step.model.gradient("opacity_logits").abs()
    for percent in (5, 25, 50, 75, 95):
        expected = float(gradient.kthvalue(1 + round(percent / 100 * 40)).values)
        assert logged[f"opacity_gradient_q{percent:02d}"] == expected
        assert logged[f"opacity_beta_q{percent:02d}"] == pytest.approx(
            expected / float(gradient.mean())
        )
    below = float((gradient < gradient.mean()).float().mean())
    assert logged["opacity_gradient_below_mean"] == pytest.approx(below)
    logged.clear()
    step = replace(step, iteration=76)
    build(GradientAwareDecay).update(step)
    assert not any("_q" in name for name in logged)


def test_pruned_gaussians_that_no_view_supported_are_counted() -> None:
    step = step_with(gaussians())
    logged: dict[str, float] = {}
    step = replace(step, log=logged.__setitem__)
    decay = build(GradientAwareDecay)
    decay.update(step)
    assert logged["pruned_unseen"] == 0
    resumed = build(GradientAwareDecay)
    resumed.restore(decay.state())
    for policy in (decay, resumed):
        # The second is split, the first and the third, which was out of sight, are pruned.
        policy.carry(torch.tensor([1, 1]), torch.tensor([True, True]))
        policy.update(step_with(some_gaussians([0.1] * 2, [0.5] * 2)))
        policy.carry(torch.tensor([0]), torch.tensor([False]))
        assert int(policy.state()["pruned_unseen"]) == 1


def test_the_number_of_gaussians_may_change_between_two_updates() -> None:
    decay = build(GradientAwareDecay)
    for count, source in ((2, [0, 1, 1, 0, 1]), (5, [4]), (1, [0])):
        update = updated(decay, step_with(some_gaussians([0.1] * count, [0.5] * count)))
        assert update.opacities.shape == (count,)
        decay.carry(torch.tensor(source), torch.zeros(len(source), dtype=torch.bool))
