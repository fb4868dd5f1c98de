from __future__ import annotations

import pytest
import torch

from registry import PluginError
from registry.priors import DepthMap
from registry.testing import check
from stereogs_plugins.regularizers.known_depth import (
    DepthFromInitializer,
    DepthRanking,
    PatchDepth,
    stereogs_register_regularizers,
)
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.regularizers.known_depth.steps import step_with_depth


def test_the_three_are_registered_and_this_one_keeps_the_contract() -> None:
    assert offered(stereogs_register_regularizers) == {
        "depth_from_initializer": DepthFromInitializer,
        "depth_ranking": DepthRanking,
        "patch_depth": PatchDepth,
    }
    check(DepthFromInitializer)


def test_value_and_gradient_are_those_of_mvpgs() -> None:
    depth = torch.tensor([[2.0, 3.0], [4.0, 9.0]], dtype=torch.float64).requires_grad_()
    valid = torch.tensor([[True, True], [True, False]])
    known = DepthMap(
        torch.tensor([[2.5, 2.0], [4.0, 0.0]], dtype=torch.float64), valid, valid.double()
    )
    step = step_with_depth(depth, maps={"view": known})
    loss = build(DepthFromInitializer).loss(step)
    assert float(loss.detach()) == pytest.approx((0.5 / 2.5 + 1.0 / 2.0 + 0) / 3)
    loss.backward()
    assert depth.grad is not None
    torch.testing.assert_close(
        depth.grad, torch.tensor([[-1 / 7.5, 1 / 6], [0, 0]], dtype=torch.float64)
    )


def test_a_render_smaller_than_the_photograph_is_held_to_the_pixels_under_its_own() -> None:
    true = torch.tensor([[2.0, 9.0, 4.0, 9.0]]).repeat(2, 1)
    valid = torch.ones(2, 4, dtype=torch.bool)
    known = DepthMap(true[:, [1, 0, 3, 2]], valid, valid.float())
    step = step_with_depth(torch.tensor([[3.0, 4.0]]), maps={"view": known})
    assert float(build(DepthFromInitializer).loss(step)) == pytest.approx((1 / 2 + 0 / 4) / 2)


def test_without_maps_it_is_refused_and_an_empty_one_adds_nothing() -> None:
    depth = torch.ones(2, 2)
    with pytest.raises(PluginError, match="no depth maps"):
        build(DepthFromInitializer).loss(step_with_depth(depth))
    nothing = DepthMap(torch.zeros(2, 2), torch.zeros(2, 2, dtype=torch.bool), torch.zeros(2, 2))
    for maps in ({"view": nothing}, {"another": nothing}):
        assert float(build(DepthFromInitializer).loss(step_with_depth(depth, maps=maps))) == 0
