from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from core_rasterizer import Rendering
from registry import Step
from registry.testing import check
from stereogs_plugins.regularizers.distant_l1 import DistantL1, farthest
from tests.stereogs_plugins.building import build, some_gaussians, step_with
from tests.stereogs_plugins.regularizers.monocular import Brightness


def seen(step: Step, rgb: torch.Tensor) -> Step:
    rendering = Rendering(rgb, torch.ones(48, 64), torch.ones(48, 64))
    step.rendered(lambda: rendering)
    return step


def test_it_keeps_the_contract() -> None:
    check(DistantL1, priors={"mono": build(Brightness)})


def test_only_the_farthest_pixels_count_and_colours_are_clamped() -> None:
    step = step_with(some_gaussians([0.1], [0.5]))
    prior = build(Brightness)
    step = replace(step, priors={"mono": prior})
    rgb = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(1)) * 1.5
    rgb.requires_grad_()
    far = (step.view.image == 0).float()  # stripes of 0 and 1; the dark half is far
    loss = build(DistantL1, share=0.5).loss(seen(step, rgb))
    expected = (far * (rgb.clamp(0, 1) - step.view.image).abs()).mean()
    assert float(loss.detach()) == pytest.approx(float(expected.detach()))
    loss.backward()
    assert rgb.grad is not None
    torch.testing.assert_close(rgb.grad, far * (rgb.detach() <= 1) / rgb.numel())


def test_the_prior_is_asked_once_for_each_photograph() -> None:
    step = step_with(some_gaussians([0.1], [0.5]))
    prior = build(Brightness)
    step = replace(step, priors={"mono": prior})
    term = build(DistantL1)
    for _ in range(3):
        term.loss(seen(step, torch.zeros(48, 64, 3)))
    assert prior.asked == 1


def test_pixels_that_the_prior_does_not_know_are_not_far() -> None:
    farness = torch.tensor([[1.0, 2.0, 3.0, 9.0]])
    assert farthest(farness, None, 0.5).tolist() == [[False, False, True, True]]
    valid = torch.tensor([[True, True, True, False]])
    assert farthest(farness, valid, 0.3).tolist() == [[False, False, True, False]]
    assert not farthest(farness, ~valid & valid, 0.5).any()
