from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from core_rasterizer import GaussianModel
from registry import Step
from stereogs_plugins.regularizers.empty_background import EmptyBackground
from tests.stereogs_plugins.building import build, moment_with, some_gaussians


def cut_out(
    alpha: torch.Tensor | None, image: torch.Tensor | None = None
) -> tuple[Step, GaussianModel]:
    """A moment whose photograph has this alpha, and other colours if they are given."""
    step, model = moment_with(some_gaussians([0.3, 0.4], [0.5, 0.7]))
    view = replace(step.view, alpha=alpha, image=step.view.image if image is None else image)
    return replace(step, sample=replace(step.sample, view=view)), model


def smaller(moment: tuple[Step, GaussianModel]) -> tuple[Step, torch.Tensor]:
    """The moment with a render of half the size, and its alpha."""
    step, model = moment
    rendering = model.render(step.sample.camera.resized(32, 24))
    step.rendered(lambda: rendering)
    return step, rendering.alpha.detach()


def half() -> torch.Tensor:
    """The left half belongs to the object, the next eighth in part."""
    alpha = torch.zeros(48, 64)
    alpha[:, :32] = 1
    alpha[:, 32:40] = 0.25
    return alpha


def test_it_is_the_mean_alpha_by_the_background_as_binocular3dgs_has_it() -> None:
    step, _ = cut_out(half())
    rendered = step.rendering.alpha.detach()
    expected = float((rendered.abs() * (1 - half())).mean())
    assert expected > 0.01
    assert float(build(EmptyBackground).loss(step).detach()) == pytest.approx(expected, rel=1e-6)


def test_squared_it_is_the_mean_over_the_backdrop_alone_as_cor_gs_has_it() -> None:
    image = torch.full((48, 64, 3), 0.5)
    image[:, :40] = 29 / 255 - 1e-4
    step, _ = cut_out(None, image)
    rendered = step.rendering.alpha.detach()
    expected = float(rendered[:, :40].square().mean())
    loss = build(EmptyBackground, squared=True, dark=29).loss(step)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("squared", [False, True])
def test_descending_its_gradient_clears_the_background(squared: bool) -> None:
    step, model = cut_out(half())
    model.zero_gradients()
    loss = build(EmptyBackground, squared=squared).loss(step)
    loss.backward()
    gradient = model.gradient("opacity_logits").clone()
    logits, tiny = model.read("opacity_logits"), 1e-2
    for index in range(2):
        sides = []
        for sign in (1, -1):
            moved = logits.clone()
            moved[index] += sign * tiny
            rendering = step.render(
                step.sample.camera, opacity_scale=moved.sigmoid() / logits.sigmoid(), gradient=False
            )
            share = 1 - half()
            term = (
                (rendering.alpha.square() * share).sum() / share.sum()
                if squared
                else (rendering.alpha * share).mean()
            )
            sides.append(float(term))
        assert float(gradient[index]) == pytest.approx((sides[0] - sides[1]) / (2 * tiny), rel=1e-3)


def test_a_photograph_without_background_asks_for_nothing() -> None:
    for alpha in (None, torch.ones(48, 64)):
        step, _ = cut_out(alpha)
        assert float(build(EmptyBackground).loss(step)) == 0


@pytest.mark.parametrize("squared", [False, True])
def test_beside_smaller_photographs_it_takes_every_second_pixel(squared: bool) -> None:
    speck = torch.ones(48, 64)
    speck[0, 0] = 0  # of four pixels, a render of half the size takes the last
    for alpha, seen in ((half(), half()[1::2, 1::2]), (speck, torch.ones(24, 32))):
        step, rendered = smaller(cut_out(alpha))
        share = 1 - seen
        expected = rendered.square() * share / max(float(share.mean()), 1e-6)
        term = float(build(EmptyBackground, squared=squared).loss(step).detach())
        assert term == pytest.approx(
            float((expected if squared else rendered * share).mean()), rel=1e-5
        )
