from __future__ import annotations

from typing import Any

import pytest
import torch

from registry.priors import MonocularDepth
from registry.testing import check
from stereogs_plugins.regularizers.known_depth import DepthRanking
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.regularizers.known_depth.steps import step_with_depth
from tests.stereogs_plugins.regularizers.monocular import Brightness

SLOPE = torch.linspace(1, 2, 40, dtype=torch.float64)[None, :].expand(30, 40).contiguous()


def test_it_keeps_the_contract() -> None:
    check(DepthRanking, priors={"mono": build(Brightness)})
    mvpgs: dict[str, Any] = {"pairs": 512, "reach": None, "margin": 0.0, "continuity": 0.0}
    check(DepthRanking, priors={"mono": build(Brightness)}, **mvpgs)


def test_a_right_order_costs_nothing_and_a_wrong_one_the_difference() -> None:
    ranking = {"reach": None, "margin": 0.0, "continuity": 0.0, "pairs": 20_000}
    right = step_with_depth(SLOPE, inverse_depth=1 / SLOPE)
    wrong = step_with_depth(SLOPE, inverse_depth=SLOPE)
    assert float(build(DepthRanking, **ranking).loss(right)) == 0
    # Two uniform columns are a third of the range apart on average; sqrt(near far) is 2.
    assert float(build(DepthRanking, **ranking).loss(wrong)) == pytest.approx(1 / 3 / 2, rel=0.03)


def test_depth_with_a_mask_is_compared_where_it_is_valid() -> None:
    ranking = {"reach": None, "margin": 0.0, "continuity": 0.0}
    wrong = -SLOPE.clone()
    wrong[:, 20:] = SLOPE[:, 20:]
    right_half = torch.arange(40).expand(30, 40) >= 20
    for valid, loss_is_zero in ((right_half, True), (~right_half, False), (None, False)):
        found = MonocularDepth(wrong, inverse=False, valid=valid)
        step = step_with_depth(SLOPE, inverse_depth=found)
        assert (float(build(DepthRanking, **ranking).loss(step)) == 0) == loss_is_zero


def test_margin_and_continuity_are_those_of_sparsenerf() -> None:
    """On two flat halves the pairs across the edge cost, the pairs within a half do not."""
    halves = torch.ones(30, 40, dtype=torch.float64)
    halves[:, 20:] = 3.0
    step = step_with_depth(halves, inverse_depth=halves)  # the far half is said to be near
    ranking = {"margin": 0.01, "reach": None, "pairs": 20_000}
    loss = build(DepthRanking, continuity=0.0, **ranking).loss(step)
    assert float(loss) == pytest.approx(0.5 * (2 / 2 + 0.01), rel=0.03)
    # Among eight neighbours one of the same half is nearly always found: nothing to hold together.
    together = build(DepthRanking, continuity=1.0, **ranking).loss(step)
    assert float(together - loss) < 0.01
    # If the prior sees one surface, neighbours across the rendered edge cost their difference.
    flat = step_with_depth(halves, inverse_depth=torch.ones_like(halves))
    split = build(DepthRanking, continuity=1.0, **ranking).loss(flat)
    across = 2 * (1 + 2 + 3) / 7 / 40  # of each pixel's 7 columns, three columns before and behind
    assert float(split) == pytest.approx(2 * across * (2 / 2 - 0.01), rel=0.15)


def test_pairs_stay_within_reach() -> None:
    """A step edge is crossed by pairs of reach r about it only."""
    halves = torch.ones(30, 40, dtype=torch.float64)
    halves[:, 20:] = 3.0
    step = step_with_depth(halves, inverse_depth=halves)
    near = build(DepthRanking, reach=2, margin=0.0, continuity=0.0, pairs=50_000).loss(step)
    crossing = 2 * (2 / 5 + 1 / 5) / 40
    assert float(near) == pytest.approx(crossing * 2 / 2, rel=0.1)


def test_its_gradient_is_that_of_finite_differences() -> None:
    generator = torch.Generator().manual_seed(4)
    depth = (1 + torch.rand(6, 7, generator=generator, dtype=torch.float64)).requires_grad_()
    order = torch.rand(6, 7, generator=generator, dtype=torch.float64)

    def loss(values: torch.Tensor) -> torch.Tensor:
        return build(DepthRanking, pairs=64, reach=3, continuity=0.5).loss(
            step_with_depth(values, inverse_depth=order)
        )

    assert torch.autograd.gradcheck(loss, (depth,))


def test_depth_of_unknown_pixels_ranks_nothing() -> None:
    from stereogs_plugins.regularizers.known_depth.estimate import Farness

    ranking = build(DepthRanking, margin=0.0, continuity=1.0, reach=None)
    step = step_with_depth(SLOPE)
    known = torch.zeros_like(SLOPE, dtype=torch.bool)

    class Nothing(Farness):
        def of(self, step: object) -> tuple[torch.Tensor, torch.Tensor]:
            return -SLOPE, known

    ranking._farness = Nothing(None)
    assert float(ranking.loss(step)) == 0
