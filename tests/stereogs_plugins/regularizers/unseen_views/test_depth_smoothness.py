from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Rendering
from registry import Step
from stereogs_plugins.regularizers.unseen_views import DepthSmoothness
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def step_that_renders(depth: Tensor, alpha: Tensor, iteration: int = 500) -> Step:
    step = step_with(some_gaussians([0.1], [0.5]), iteration=iteration)

    def render(camera: Camera, **_: object) -> Rendering:
        return Rendering(torch.zeros(*depth.shape, 3), depth, alpha)

    return replace(step, render=render)


def by_loops(depth: Tensor, alpha: Tensor | None) -> float:
    """RegNeRF's smoothness, one patch that is the whole image; the scene reaches from 1 to 10."""
    z = depth / math.sqrt(10)
    total, count = 0.0, 0
    for i in range(z.shape[0] - 1):
        for j in range(z.shape[1] - 1):
            term = (z[i, j] - z[i, j + 1]) ** 2 + (z[i, j] - z[i + 1, j]) ** 2
            total += float(term if alpha is None else alpha[i, j] * term)
            count += 1
    return total / count


@pytest.mark.parametrize("by_alpha", [False, True])
def test_value_and_gradient_are_those_of_the_formula(by_alpha: bool) -> None:
    generator = torch.Generator().manual_seed(1)
    depth, alpha = torch.rand(2, 5, 6, generator=generator, dtype=torch.float64)
    term = build(DepthSmoothness, by_alpha=by_alpha)
    loss = term.loss(step_that_renders(depth, alpha))
    assert float(loss) == pytest.approx(by_loops(depth, alpha if by_alpha else None))
    assert torch.autograd.gradcheck(
        lambda z: term.loss(step_that_renders(z, alpha)), (depth.requires_grad_(),)
    )


def test_the_weight_falls_as_regnerfs_does() -> None:
    """From 400 to 0.1 over 512 steps, then 0.1: here with a weight of 0.1 in the pipeline."""
    depth = torch.rand(5, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    term = build(DepthSmoothness, first_factor=400 / 0.1, factor_iterations=512)
    once = float(build(DepthSmoothness).loss(step_that_renders(depth, depth)))
    for iteration, weight in ((256, (400 + 0.1) / 2), (512, 0.1), (5000, 0.1)):
        loss = float(term.loss(step_that_renders(depth, depth, iteration)))
        assert 0.1 * loss / once == pytest.approx(weight)
