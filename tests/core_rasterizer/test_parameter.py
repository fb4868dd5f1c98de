"""Parameters in autograd, for losses on parameters."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from core_rasterizer import Adam, Device, ExplainedError, GaussianError, GaussianModel
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import parameters, rates, view

NAMES = (*PARAMETERS, "opacities", "scales")
STORED = {"opacities": "opacity_logits", "scales": "log_scales"}
RATES = rates(1e-2)


def weights_like(values: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(8)
    return torch.randn(values.shape, generator=generator, dtype=values.dtype)


def loss_on(values: Tensor) -> Tensor:
    """A loss without constant derivatives."""
    return (weights_like(values) * (values + 0.3 * values.square())).sum()


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_the_model(device: Device, name: str) -> None:
    model = GaussianModel(parameters(20), device)
    values = model.parameter(name)
    assert values.requires_grad
    expected = getattr(model, name)() if name in STORED else model.read(name)
    assert torch.equal(values, expected)
    assert values.shape == expected.shape
    with torch.no_grad():
        assert not model.parameter(name).requires_grad
    kept = values.detach().clone()
    model.write(STORED.get(name, name), model.read(STORED.get(name, name)) + 1)
    assert torch.equal(values, kept)


@pytest.mark.parametrize("name", NAMES)
def test_the_gradient_passes_finite_differences(device: Device, name: str) -> None:
    model = GaussianModel(parameters(3, sh_degree=1), device, dtype=torch.float64)
    loss_on(model.parameter(name)).backward()
    stored = STORED.get(name, name)
    gradient = model.gradient(stored).clone().flatten()
    start = model.read(stored).clone().contiguous()
    for place in range(start.numel()):
        ends = []
        for step in (1e-5, -1e-5):
            moved = start.clone()
            moved.view(-1)[place] += step
            model.write(stored, moved)
            ends.append(loss_on(model.parameter(name)).item())
        assert gradient[place].item() == pytest.approx(
            (ends[0] - ends[1]) / 2e-5, rel=1e-6, abs=1e-8
        )
    for other in set(PARAMETERS) - {stored}:
        assert not model.gradient(other).any(), other


def test_nearly_opaque_ones_keep_their_slope(device: Device) -> None:
    """1 - sigmoid(x) would be 0 in float32."""
    model = GaussianModel(parameters(2), device)
    model.write("opacity_logits", torch.tensor([20.0, -20.0]))
    model.parameter("opacities").sum().backward()
    assert model.gradient("opacity_logits").tolist() == pytest.approx([math.exp(-20)] * 2)


def test_losses_on_parameters_and_on_renders_add_up(device: Device) -> None:
    """In any order, in one backward pass or several."""
    model = GaussianModel(parameters(40), device)

    def image_loss() -> Tensor:
        return model.render(view(), sh_degree=1).rgb.square().sum()

    def parameter_loss() -> Tensor:
        sizes = model.parameter("scales").square().mean()
        return 100 * (sizes + model.parameter("opacities").mean()) + loss_on(model.parameter("sh"))

    def gradients(*losses: Tensor) -> dict[str, Tensor]:
        model.zero_gradients()
        for loss in losses:
            loss.backward()
        return {name: model.gradient(name).clone() for name in PARAMETERS}

    model.render(view(1)).rgb.sum().backward()  # what is forgotten next, in all bands
    images, others = gradients(image_loss()), gradients(parameter_loss())
    assert all(others[name].any() for name in ("log_scales", "opacity_logits", "sh"))
    for together in (
        gradients(image_loss() + parameter_loss()),
        gradients(image_loss(), parameter_loss()),
        gradients(parameter_loss(), image_loss()),
    ):
        for name in PARAMETERS:
            assert torch.equal(together[name], images[name] + others[name]), name
    model.zero_gradients()
    assert not any(model.gradient(name).any() for name in PARAMETERS)


def test_the_optimizer_steps_on_the_sum(device: Device) -> None:
    """Compared with an optimizer whose gradient rows are the sum."""
    model, plain = (GaussianModel(parameters(20), device) for _ in range(2))
    optimizer, other = Adam(model), Adam(plain)
    for _ in range(2):
        model.zero_gradients()
        loss = model.render(view()).rgb.sum() + loss_on(model.parameter("means"))
        (loss + loss_on(model.parameter("scales"))).backward()
        rows = [model.gradient(name).reshape(20, -1).T for name in PARAMETERS]
        plain.gradients.rows.write(
            torch.nn.functional.pad(torch.cat(rows), (0, plain.capacity - 20))
        )
        optimizer.step(RATES, 3)
        other.step(RATES, 3)
        assert torch.equal(model.gradients.rows.read(), plain.gradients.rows.read())
    assert model.digest() == plain.digest()


def test_bands_that_only_a_loss_on_parameters_reached_are_forgotten_too(device: Device) -> None:
    model = GaussianModel(parameters(20), device)
    for on_parameters in (True, False):
        model.zero_gradients()
        if on_parameters:
            loss_on(model.parameter("sh")).backward()
        model.render(view(), sh_degree=0).rgb.sum().backward()
        model.gradients.store()
        assert model.gradient("sh")[:, 1:].any() == on_parameters
        assert model.gradient("sh")[:, 0].any()


def test_a_loss_on_parameters_touches_nothing(device: Device) -> None:
    model = GaussianModel(parameters(60), device)
    model.render(view()).rgb.sum().backward()
    touched = model.touched()
    assert 0 < touched.sum() < 60
    model.zero_gradients()
    loss = model.parameter("opacities").sum() + model.parameter("means").square().sum()
    (loss + model.render(view()).rgb.sum()).backward()
    assert model.gradient("opacity_logits").all()
    assert torch.equal(model.touched(), touched)


@pytest.mark.parametrize("name", NAMES)
def test_an_undefined_gradient_names_its_parameter(device: Device, name: str) -> None:
    model = GaussianModel(parameters(10), device)
    model.parameter("quaternions").sum().backward()
    values = model.parameter(name)
    shifted = values - values.detach()
    broken = torch.where((torch.arange(10) == 6).reshape(-1, *[1] * (values.ndim - 1)), 1.0, 0.0)
    with pytest.raises(GaussianError, match="undefined gradient") as error:
        (broken * shifted.abs().sqrt()).sum().backward()
    assert (error.value.field, error.value.index) == (name, 0)  # 0 times infinity, everywhere
    with pytest.raises(GaussianError) as error:
        (values[6] * math.inf).sum().backward()
    assert error.value.index == 6
    assert torch.equal(model.gradient("quaternions"), torch.ones(10, 4))


def test_an_undefined_image_gradient_leaves_zeros(device: Device) -> None:
    """`zero_gradients` still holds after a failed backward pass."""
    model = GaussianModel(parameters(10), device)
    model.render(view()).rgb.sum().backward()
    model.zero_gradients()
    with pytest.raises(ExplainedError, match="undefined gradient"):
        (model.render(view()).rgb * math.inf).sum().backward()
    assert not model.gradient("means").any()


def test_an_edit_in_between_raises(device: Device) -> None:
    model = GaussianModel(parameters(10), device)
    loss = model.parameter("scales").sum()
    model.adopt(model.parameters.read().clone(), model.count)
    with pytest.raises(GaussianError, match="call backward before") as error:
        loss.backward()
    assert error.value.fix or error.value.where
    assert not model.gradient("log_scales").any()


def test_unknown_names_raise(device: Device) -> None:
    model = GaussianModel(parameters(5), device)
    with pytest.raises(GaussianError, match="unknown parameter 'colors'"):
        model.parameter("colors")


def test_the_same_losses_give_the_same_bits(device: Device) -> None:
    def outcome() -> Tensor:
        model = GaussianModel(parameters(50), device)
        loss = sum((loss_on(model.parameter(name)) for name in NAMES), torch.zeros(()))
        (loss + model.render(view()).rgb.square().sum()).backward()
        model.gradients.store()
        return model.gradients.rows.read().clone()

    assert torch.equal(outcome(), outcome())


def test_a_discrete_device_copies_only_used_rows(device: Device) -> None:
    discrete = device.as_discrete()
    model = GaussianModel(parameters(100), discrete)
    optimizer = Adam(model)
    model.zero_gradients()
    optimizer.step(RATES, 3)
    before = discrete.bytes_moved
    model.gradients.store()
    assert discrete.bytes_moved == before
    model.parameter("opacities").sum().backward()
    optimizer.step(RATES, 3)
    # Values, rows there and back, and whether the step left anything undefined.
    assert discrete.bytes_moved - before == 3 * 4 * model.capacity + 4
