"""Tests by the author of a plugin: the contract, and the purpose of the component."""

import pytest
import torch
from stereogs_running_mean import RunningMean, RunningMeanSettings

from core_rasterizer import GaussianModel, Gaussians, open_device
from stereogs.api import Context
from stereogs.testing import check, step_of, tiny_scene


def test_it_keeps_the_contract() -> None:
    check(RunningMean)


def two_gaussians() -> tuple[GaussianModel, RunningMean]:
    device, half = open_device(), torch.full((2,), 0.5)
    positions = torch.tensor([[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]])
    cloud = Gaussians.from_points(positions, torch.full((2, 3), 0.5), 0.2 * half, half, 0)
    term = RunningMean(RunningMeanSettings(momentum=0.9), Context("running_mean", 0, device))
    return GaussianModel(cloud, device), term


def move_the_second(model: GaussianModel) -> None:
    means = model.read("means").clone()
    means[1, 0] += 1
    model.write("means", means)


def test_it_pulls_back_to_the_running_mean() -> None:
    scene, (model, term) = tiny_scene(), two_gaussians()
    step = step_of(model, scene)
    assert float(term.loss(step).detach()) == 0
    move_the_second(model)
    model.zero_gradients()
    loss = term.loss(step)
    # It moved by 1, its mean by 0.1; of six coordinates, in units of the extent.
    assert float(loss.detach()) == pytest.approx(0.9**2 / step.extent**2 / 6, rel=1e-5)
    loss.backward()
    gradient = model.gradient("means")
    assert float(gradient[1, 0]) == pytest.approx(2 * 0.9 / step.extent**2 / 6, rel=1e-5)
    assert int((gradient != 0).sum()) == 1


def test_new_gaussians_begin_where_they_are() -> None:
    scene, (model, term) = tiny_scene(), two_gaussians()
    step = step_of(model, scene)
    term.loss(step)
    term.carry(torch.tensor([0, 0]), torch.tensor([False, True]))
    move_the_second(model)
    assert float(term.loss(step).detach()) == 0
