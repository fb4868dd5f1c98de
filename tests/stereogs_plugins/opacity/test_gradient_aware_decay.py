from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import Gaussians
from stereogs_plugins.opacity.gradient_aware_decay import (
    GradientAwareDecay,
    stereogs_register_opacity_policies,
)
from tests.stereogs_plugins.building import build, offered, some_gaussians, step_with


def gaussians() -> Gaussians:
    """Two in view, and one far outside, which gets no gradient."""
    scene = some_gaussians([0.05, 0.2, 0.1], [0.3, 0.8, 0.5])
    scene.means[2, 0] = 100
    return scene


def test_is_offered_as_gradient_aware_decay() -> None:
    assert offered(stereogs_register_opacity_policies) == {
        "gradient_aware_decay": GradientAwareDecay
    }


@pytest.mark.parametrize("wrt", ["activated", "logit"])
def test_is_the_papers_formula(wrt: str) -> None:
    step = step_with(gaussians())
    update = build(GradientAwareDecay, wrt=wrt).update(step)
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
        assert other.rendering is not None
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
    torch.testing.assert_close(decay.factor(relative / 10, relative), torch.tensor(factors))


def test_contributing_spares_what_this_view_does_not_show() -> None:
    update = build(GradientAwareDecay, scope="contributing").update(step_with(gaussians()))
    assert update.opacities[2] == pytest.approx(0.5)
    assert update.opacities[0] < 0.3


def test_without_any_gradient_all_decay_by_the_base() -> None:
    hidden = gaussians()
    hidden.means[:, 2] = -5
    update = build(GradientAwareDecay).update(step_with(hidden))
    torch.testing.assert_close(update.opacities, 0.99 * torch.tensor([0.3, 0.8, 0.5]))
