"""Optimizer and topology at their limits: no moments, everything pruned, overflowing gradients."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from core_rasterizer import (
    Adam,
    Device,
    Edit,
    ExplainedError,
    GaussianError,
    GaussianModel,
    apply_edit,
)
from core_rasterizer.layout import PARAMETERS, rows_of
from tests.core_rasterizer.scenes import parameters, rates, view

RATES = rates(1e-3)


def everything(count: int) -> torch.Tensor:
    return torch.ones(count, dtype=torch.bool)


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def assert_of_one_length(model: GaussianModel, optimizer: Adam) -> None:
    """Check that every per-Gaussian array has the right length."""
    for name in PARAMETERS:
        assert len(model.read(name)) == model.count, name
        assert len(model.gradient(name)) == model.count, name
    assert len(model.opacities()) == len(model.scales()) == model.count
    assert len(model.statistics.screen_gradient()) == model.count
    assert model.statistics.sums().shape == (2, model.count)
    state = optimizer.state()
    shape = (model.rows, model.count)
    assert tuple(state["first_moments"].shape) == tuple(state["second_moments"].shape) == shape


def test_an_edit_that_removes_all_changes_nothing(device: Device) -> None:
    """Case 13: a decay has made everything prunable. The error is clear, model and moments stay whole."""
    model = GaussianModel(parameters(50), device)
    optimizer = Adam(model)
    model.render(view(), collect_statistics=True).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    digest, state = model.digest(), optimizer.state()
    with pytest.raises(GaussianError, match="remove all 50") as error:
        apply_edit(model, optimizer, Edit(clone=everything(50), prune=everything(50)), seeded())
    assert error.value.field == "prune"
    assert model.digest() == digest
    assert model.statistics.screen_gradient().any()
    assert all(torch.equal(values, state[name]) for name, values in optimizer.state().items())
    assert_of_one_length(model, optimizer)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30, -3e38])
def test_an_undefined_gradient_changes_nothing(device: Device, value: float) -> None:
    """Case 15: one undefined gradient. Its parameter stays, others change, later steps recover."""
    model = GaussianModel(parameters(20), device)
    optimizer = Adam(model)
    gradients = torch.ones(model.rows, model.capacity)
    gradients[10, 3] = value
    before = model.read("opacity_logits").clone()
    model.gradients.rows.write(gradients)
    optimizer.step(RATES, active_sh_degree=3)
    moved = model.read("opacity_logits") != before
    assert moved.tolist() == [index != 3 for index in range(20)]
    for moments in ("first_moments", "second_moments"):
        assert torch.isfinite(optimizer.state()[moments]).all()
    model.gradients.rows.write(torch.ones(model.rows, model.capacity))
    optimizer.step(RATES, active_sh_degree=3)
    assert (model.read("opacity_logits") != before).all()
    assert all(torch.isfinite(model.read(name)).all() for name in PARAMETERS)


def test_a_thousand_steps_without_gradient(device: Device) -> None:
    """Case 16: moments fade through the denormal numbers to nothing, and never to a NaN."""
    model = GaussianModel(parameters(20), device)
    optimizer = Adam(model)
    model.render(view()).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    model.zero_gradients()
    for _ in range(1000):
        optimizer.step(RATES, active_sh_degree=3)
    settled = model.digest()
    assert all(torch.isfinite(model.read(name)).all() for name in PARAMETERS)
    optimizer.step(RATES, active_sh_degree=3)
    assert model.digest() == settled


def test_a_first_step_without_gradient_moves_nothing(device: Device) -> None:
    """Case 15: all gradients zero while the moments are: 0 / (0 + epsilon) is 0."""
    model = GaussianModel(parameters(20), device)
    before = model.digest()
    Adam(model).step(RATES, active_sh_degree=3)
    assert model.digest() == before


def test_edits_and_resets_before_the_first_step(device: Device) -> None:
    """Case 31: no moments yet when Gaussians are pruned, cloned, split, decayed, reset and saved."""
    model = GaussianModel(parameters(40), device)
    optimizer = Adam(model)
    optimizer.reset_moments("opacity_logits")
    optimizer.restore(optimizer.state())
    keep = torch.arange(40) % 4 == 0
    apply_edit(model, optimizer, Edit(keep, ~keep, torch.arange(40) % 7 == 0), seeded())
    model.write("opacity_logits", model.read("opacity_logits") - 1)
    assert_of_one_length(model, optimizer)
    assert not optimizer.state()["first_moments"].any()
    model.render(view()).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    assert_of_one_length(model, optimizer)


def test_densification_and_decay_in_one_iteration(device: Device) -> None:
    """Case 30: between a backward pass and its step the Gaussians decay, grow past their buffers, shrink."""
    model = GaussianModel(parameters(16), device)  # exactly full: 16 is the step of capacities
    optimizer = Adam(model)
    for edit in ("clone", "split", "prune"):
        model.zero_gradients()
        model.render(view(), collect_statistics=True).rgb.sum().backward()
        model.write("opacity_logits", model.read("opacity_logits") - 0.05)
        chosen = everything(model.count)
        if edit == "prune":
            chosen[5] = False
        changes: dict[str, Any] = {edit: chosen}
        apply_edit(model, optimizer, Edit(**changes), seeded())
        assert_of_one_length(model, optimizer)
        optimizer.step(RATES, active_sh_degree=3)
        assert all(torch.isfinite(model.read(name)).all() for name in PARAMETERS)
    assert model.count == 1


def test_an_edit_that_changes_nothing(device: Device) -> None:
    """Case 30: empty masks keep every bit of parameters and moments."""
    model = GaussianModel(parameters(33), device)
    optimizer = Adam(model)
    model.render(view()).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    digest, moments = model.digest(), optimizer.state()["first_moments"]
    apply_edit(model, optimizer, Edit(), seeded())
    assert model.digest() == digest
    assert torch.equal(optimizer.state()["first_moments"], moments)


@pytest.mark.parametrize("field", ["log_scales", "quaternions", "means"])
@pytest.mark.parametrize("value", [-3e38, -100.0, 0.0, 1e-40, 1e-13, 100.0, 1e20, 3e38])
def test_children_of_extreme_parents_are_finite(device: Device, field: str, value: float) -> None:
    """Cases 3, 6 and 9 for a split: exp overflows, the quaternion's square does, the length vanishes."""
    gaussians = parameters(20)
    getattr(gaussians, field)[4] = value
    model = GaussianModel(gaussians, device)
    apply_edit(model, Adam(model), Edit(split=everything(20)), seeded())
    for name in PARAMETERS:
        assert torch.isfinite(model.read(name)).all(), name


def test_duplicates_are_set_apart_by_a_split(device: Device) -> None:
    """Case 21: Gaussians at distance 0 of each other get children at different places."""
    gaussians = parameters(1)
    twins = type(gaussians)(**{n: v.repeat_interleave(5, 0) for n, v in vars(gaussians).items()})
    model = GaussianModel(twins, device)
    apply_edit(model, Adam(model), Edit(split=everything(5)), seeded())
    assert len(model.read("means").unique(dim=0)) == 10


@pytest.mark.parametrize("rate", [math.nan, math.inf, -math.inf, 1e38])
def test_an_undefined_learning_rate_is_named(device: Device, rate: float) -> None:
    model = GaussianModel(parameters(5), device)
    digest = model.digest()
    with pytest.raises(ExplainedError, match="learning rate of log_scales") as error:
        Adam(model).step(RATES | {"log_scales": rate}, active_sh_degree=3)
    assert "log_scales" in error.value.where
    assert model.digest() == digest


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", PARAMETERS)
def test_an_undefined_value_is_not_written(device: Device, name: str, value: float) -> None:
    """Case 3: writing NaN raises an error with field and index."""
    model = GaussianModel(parameters(30), device)
    digest, values = model.digest(), model.read(name).clone()
    values[17] = value
    with pytest.raises(GaussianError, match="not finite") as error:
        model.write(name, values)
    assert (error.value.field, error.value.index) == (name, 17)
    assert model.digest() == digest


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_that_a_step_finds_undefined_is_named(device: Device, name: str) -> None:
    """The step checks every value that it changes."""
    model = GaussianModel(parameters(30), device)
    optimizer = Adam(model)
    optimizer.step(RATES, active_sh_degree=3)
    optimizer.check_parameters()
    first, last = rows_of(name, model.sh_degree)
    rows = model.parameters.read(first, last).clone()
    rows[-1, 17] = math.nan
    model.parameters.write(rows, first, last)
    optimizer.check_parameters()
    optimizer.step(RATES, active_sh_degree=3)
    with pytest.raises(GaussianError, match="1 values are not finite") as error:
        optimizer.check_parameters()
    assert (error.value.field, error.value.index) == (name, 17)


def test_a_parameter_that_a_step_makes_infinite_is_named(device: Device) -> None:
    gaussians = parameters(30)
    gaussians.means[4, 1] = 3.4e38
    model = GaussianModel(gaussians, device)
    optimizer = Adam(model)
    model.parameter("means")[4, 1].neg().backward()
    optimizer.step(RATES | {"means": 9e36}, active_sh_degree=3)
    with pytest.raises(GaussianError, match="not finite") as error:
        optimizer.check_parameters()
    assert (error.value.field, error.value.index) == ("means", 4)
