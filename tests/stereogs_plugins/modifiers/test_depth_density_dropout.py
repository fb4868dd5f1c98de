from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from stereogs_plugins.modifiers.depth_density_dropout import DepthDensityDropout, density
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def test_density_is_minus_the_mean_distance_to_six_neighbours() -> None:
    means = torch.randn(30, 3, generator=torch.Generator().manual_seed(3))
    distances = torch.cdist(means.double(), means.double()).sort(dim=1).values
    expected = -distances[:, 1:7].mean(1)
    torch.testing.assert_close(density(means).double(), expected, rtol=1e-6, atol=1e-6)
    assert density(means[:1]).tolist() == [0]
    assert float(density(means[:2])[0]) == pytest.approx(-float((means[0] - means[1]).norm()))


def test_the_chance_is_the_papers_on_a_small_array() -> None:
    """The authors' settings for fern: 0.7, 0.3, 0.1 to 0.3; thirds count 1, 0.7 and 0.3."""
    fern = {"depth_weight": 0.7, "density_weight": 0.3, "first_rate": 0.1, "last_rate": 0.3}
    depth = torch.tensor([2.0, 6.0, 4.0])
    crowd = torch.tensor([-3.0, -1.0, -2.0])
    chance = build(DepthDensityDropout, **fern).chance(depth, crowd, 0.5)
    # scores 0.7, 0.3 and 0.35 + 0.15; 33 % of three is none, 67 % are two, so the first counts 0.7 too
    expected = torch.tensor([0.7 * 0.7, 0.3 * 0.3, 0.5 * 0.7]) * 0.2
    torch.testing.assert_close(chance, expected)


@pytest.mark.parametrize(("done", "rate"), [(0.0, 0.05), (0.5, 0.175), (1.0, 0.3)])
def test_thirds_by_depth_and_a_rate_that_grows(done: float, rate: float) -> None:
    depth = torch.linspace(1, 2, 100)
    chance = build(DepthDensityDropout).chance(depth, torch.zeros(100), done)
    shares = torch.tensor([1.0] * 33 + [0.7] * 34 + [0.3] * 33)
    nearness = torch.linspace(1, 0, 100)
    torch.testing.assert_close(chance, 0.3 * nearness * rate * shares, atol=1e-6, rtol=1e-5)


def test_leaves_out_as_many_as_the_chance_says_and_raises_nobody() -> None:
    count = 20_000
    step = step_with(some_gaussians([0.01] * count, [0.5] * count), iteration=1000)
    settings = {"depth_weight": 1.0, "density_weight": 0.0, "last_rate": 0.9}
    dropout = build(DepthDensityDropout, **settings)
    scale = dropout.opacity_scale(step)
    assert set(scale.unique().tolist()) == {0.0, 1.0}
    # All at one depth: nearness is 1 for all, and the three thirds lose 90, 63 and 27 %.
    expected = 0.9 * (0.33 + 0.34 * 0.7 + 0.33 * 0.3)
    assert float((scale == 0).float().mean()) == pytest.approx(expected, abs=0.01)


def test_densities_follow_an_edit_and_are_measured_anew_in_time() -> None:
    step = step_with(some_gaussians([0.01] * 5, [0.5] * 5), iteration=499)
    dropout = build(DepthDensityDropout)
    dropout.opacity_scale(step)
    first = dropout.state()["density"]
    dropout.carry(torch.tensor([4, 0, 0]), torch.tensor([False, False, True]))
    assert torch.equal(dropout.state()["density"], first[[4, 0, 0]])
    step = replace(step, iteration=500)
    dropout.opacity_scale(step)
    assert torch.equal(dropout.state()["density"], first)
