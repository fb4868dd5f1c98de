from __future__ import annotations

import pytest
import torch

from core_rasterizer import Adam, GaussianModel, Gaussians, apply_edit, open_device
from registry import Step
from registry.testing import step_of, tiny_scene
from stereogs_plugins.densification.proximity_unpooling import ProximityUnpooling, proximity
from tests.stereogs_plugins.building import build

CROSS = torch.tensor([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4], [20, 0, 0]])


def moment(sizes: list[float]) -> tuple[Step, GaussianModel]:
    """Points on a cross, one far away; the extent is 1."""
    colors = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    opacities = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5])
    gaussians = Gaussians.from_points(CROSS, colors, torch.tensor(sizes), opacities, 1)
    model = GaussianModel(gaussians, open_device())
    return step_of(model, tiny_scene(), extent=1.0), model


def test_proximity_is_the_mean_squared_distance_to_three_neighbours() -> None:
    squared, neighbours = proximity(CROSS)
    assert float(squared[0]) == pytest.approx((4 + 9 + 16) / 3)
    assert float(squared[4]) == pytest.approx((18**2 + 20**2 + 20**2 + 3**2) / 3)
    assert neighbours[0].tolist() == [1, 2, 3]
    assert [proximity(CROSS[:n])[1].shape for n in (1, 2, 3)] == [(1, 0), (2, 1), (3, 2)]


def test_large_lonely_ones_get_three_new_ones_halfway() -> None:
    step, model = moment([1.5, 0.5, 0.5, 0.5, 0.5])
    edit = build(ProximityUnpooling).refine(step)
    assert edit is not None
    assert edit.split is not None
    assert not edit.split.any()  # 29 / 3 is more than 5 and less than 10
    apply_edit(model, Adam(model), edit, torch.Generator())
    assert model.count == 8
    after = model.gaussians()
    torch.testing.assert_close(after.means[5:], CROSS[1:4] / 2)
    torch.testing.assert_close(model.opacities()[5:], torch.tensor([0.2, 0.3, 0.4]))
    torch.testing.assert_close(model.scales()[5:], torch.full((3, 3), 0.5))
    assert not after.sh[5:].any()


def test_the_loneliest_are_split_and_small_ones_left_alone() -> None:
    edit = build(ProximityUnpooling).refine(moment([0.5, 0.5, 0.5, 0.5, 1.5])[0])
    assert edit is not None
    assert edit.split is not None
    assert edit.split.tolist() == [False] * 4 + [True]
    assert build(ProximityUnpooling).refine(moment([0.9] * 5)[0]) is None
