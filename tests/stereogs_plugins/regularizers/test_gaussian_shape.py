from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Gaussians
from stereogs_plugins.regularizers.gaussian_shape import GaussianShape
from tests.stereogs_plugins.building import build, moment_with

SCALES = torch.tensor([[0.1, 0.2, 0.4], [0.3, 0.25, 0.28], [0.05, 0.2, 0.1]])
OPACITIES = torch.tensor([0.5, 0.9, 0.1])


def some_gaussians() -> Gaussians:
    gaussians = Gaussians.from_points(
        torch.tensor([[0.0, 0, 4]]).repeat(3, 1),
        torch.full((3, 3), 0.5),
        SCALES[:, 0],
        OPACITIES,
        0,
    )
    gaussians.log_scales[:] = SCALES.log()
    return gaussians


def by_hand(scales: Tensor, opacities: Tensor) -> Tensor:
    """DNGaussian's three penalties with its weights for LLFF."""
    longest, shortest = scales.max(dim=1).values, scales.min(dim=1).values
    above, below = opacities[opacities > 0.2], opacities[opacities < 0.2]
    opaque = 1 - (above**2).mean() + ((1 - below) ** 2).mean()
    return 0.002 * (longest / shortest).mean() + 0.001 * (longest**2).mean() + 0.001 * opaque


def test_value_and_gradient_are_those_of_the_formula() -> None:
    step, model = moment_with(some_gaussians())
    model.zero_gradients()
    loss = build(GaussianShape).loss(step)
    loss.backward()
    logs = SCALES.log().requires_grad_()
    logits = torch.logit(OPACITIES).requires_grad_()
    wanted = by_hand(logs.exp(), logits.sigmoid())
    wanted.backward()
    assert float(loss.detach()) == pytest.approx(float(wanted.detach()), rel=1e-5)
    torch.testing.assert_close(model.gradient("log_scales"), logs.grad)
    torch.testing.assert_close(model.gradient("opacity_logits"), logits.grad)


def test_a_side_without_gaussians_adds_nothing() -> None:
    only = build(GaussianShape, elongation=0, size=0, opacity=1)
    opaque = Gaussians.from_points(
        torch.tensor([[0.0, 0, 4]]),
        torch.full((1, 3), 0.5),
        torch.tensor([0.1]),
        torch.tensor([0.5]),
        0,
    )
    assert float(only.loss(moment_with(opaque)[0]).detach()) == pytest.approx(0.75)
