"""Adam on the device against torch.optim.Adam."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    ExplainedError,
    GaussianError,
    GaussianModel,
    Gaussians,
)
from core_rasterizer.layout import PARAMETER_GROUPS
from tests.core_rasterizer.scenes import random_gaussians

RATES = {
    "means": 1e-3,
    "log_scales": 5e-3,
    "quaternions": 2e-3,
    "opacity_logits": 5e-2,
    "sh_constant": 2.5e-3,
    "sh_rest": 1.25e-4,
}


def make_model(
    device: Device, dtype: torch.dtype, count: int = 37, degree: int = 3
) -> GaussianModel:
    return GaussianModel(random_gaussians(count, degree, 3), device, dtype=dtype)


def gradients_for(model: GaussianModel, step: int) -> Tensor:
    """Gradients of many magnitudes, zero now and then."""
    generator = torch.Generator().manual_seed(step)
    shape = (model.rows, model.capacity)
    gradients = torch.randn(shape, generator=generator, dtype=torch.float64)
    gradients *= 10.0 ** torch.randint(-8, 2, shape, generator=generator)
    gradients[:, step % model.count] = 0
    gradients[:, model.count :] = 0
    return gradients.to(model.dtype)


def twin_of(model: GaussianModel) -> tuple[list[Tensor], torch.optim.Adam]:
    """torch's Adam over copies of the rows of each group."""
    rows = model.parameters.read().clone()
    leaves = [rows[slice(*span)].clone().requires_grad_() for span in PARAMETER_GROUPS.values()]
    groups = [
        {"params": [t], "lr": RATES[n]} for n, t in zip(PARAMETER_GROUPS, leaves, strict=True)
    ]
    return leaves, torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15)


@pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 3e-6)], ids=["double", "float"]
)
def test_adam_is_torchs_adam(device: Device, dtype: torch.dtype, tolerance: float) -> None:
    model = make_model(device, dtype)
    optimizer = Adam(model)
    leaves, twin = twin_of(model)
    for step in range(100):
        gradients = gradients_for(model, step)
        model.gradients.rows.write(gradients)
        optimizer.step(RATES, active_sh_degree=3)
        for leaf, span in zip(leaves, PARAMETER_GROUPS.values(), strict=True):
            leaf.grad = gradients[slice(*span)].clone()
        twin.step()
    torch.testing.assert_close(
        model.parameters.read(), torch.cat(leaves).detach(), rtol=tolerance, atol=tolerance
    )


def test_moments_without_gradient_end_at_zero(device: Device) -> None:
    """Subnormal numbers, where 0.9 times the smallest is itself, are many times slower on most processors."""
    model = make_model(device, torch.float32)
    optimizer = Adam(model)
    model.gradients.rows.write(gradients_for(model, 1))
    optimizer.step(RATES, active_sh_degree=3)
    model.gradients.rows.fill(0)
    for _ in range(1000):
        optimizer.step(RATES, active_sh_degree=3)
    assert not optimizer.first_moments.read().any()


@pytest.mark.parametrize("stored", [True, False], ids=["adam", "backward and adam"])
@pytest.mark.parametrize("rate", [0.0, 0.05])
def test_opacity_logits_return_to_where_they_have_a_gradient(
    device: Device, stored: bool, rate: float
) -> None:
    """Beyond 30 they become 30; others keep the bits of their step."""
    logits = torch.tensor([100.0, 31.0, 30.0, 29.0, 0.5, -29.0, -30.0, -31.0, -1e30])
    gaussians = replace(random_gaussians(len(logits), 0, 3), opacity_logits=logits)
    kept = (logits.abs() <= 29).nonzero()[:, 0]
    others = Gaussians(**{name: values[kept] for name, values in vars(gaussians).items()})
    camera, rates = Camera.centered(torch.eye(4), 50.0, 40, 30), {**RATES, "opacity_logits": rate}

    def stepped(gaussians: Gaussians, mask: Tensor | None = None) -> Tensor:
        model = GaussianModel(gaussians, device)
        scale = None if mask is None else mask.float()
        (1e3 * model.render(camera, opacity_scale=scale).rgb.sum()).backward()
        Adam(model).step(rates, 0, keep_gradients=stored)
        return model.read("opacity_logits")

    after = stepped(gaussians, (logits.abs() <= 29))
    assert after[kept].equal(stepped(others))
    assert after[[0, 1, 7, 8]].tolist() == [30.0, 30.0, -30.0, -30.0]
    assert after.abs().max() == 30


def test_an_opaque_gaussian_becomes_transparent_again(device: Device) -> None:
    """At 100 the gradient is too small for Adam, so that it would stay opaque forever."""
    gaussians = replace(
        Gaussians.from_points(
            torch.tensor([[0.0, 0.0, 3.0]]),
            torch.ones(1, 3),
            torch.ones(1) * 0.1,
            torch.ones(1) / 2,
            0,
        ),
        opacity_logits=torch.tensor([100.0]),
    )
    model = GaussianModel(gaussians, device)
    optimizer, camera = Adam(model), Camera.centered(torch.eye(4), 50.0, 40, 30)
    still = dict.fromkeys(RATES, 0.0)
    for _ in range(70):
        model.zero_gradients()
        (1e3 * model.render(camera).rgb.sum()).backward()
        optimizer.step({**still, "opacity_logits": 0.5}, 0)
    assert float(model.opacities()) < 0.5


def test_an_infinite_opacity_logit_is_an_error(device: Device) -> None:
    model = make_model(device, torch.float32)
    rows = model.parameters.read().clone()
    rows[PARAMETER_GROUPS["opacity_logits"][0], 5] = torch.inf
    model.parameters.write(rows)
    optimizer = Adam(model)
    optimizer.step(RATES, active_sh_degree=3)
    with pytest.raises(GaussianError, match="not finite"):
        optimizer.check_parameters()


def test_bands_above_the_active_degree_stay(device: Device) -> None:
    model = make_model(device, torch.float32)
    before = model.parameters.read().clone()
    optimizer = Adam(model)
    model.gradients.rows.write(gradients_for(model, 1))
    optimizer.step(RATES, active_sh_degree=1)
    changed = (model.parameters.read() != before)[:, : model.count].any(dim=1)
    assert changed.tolist() == [True] * (11 + 3 * 4) + [False] * (3 * 12)
    assert (optimizer.state()["second_moments"][11 + 3 * 4 :] == 0).all()


@pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 3e-6)], ids=["double", "float"]
)
def test_skipped_groups_are_parameters_without_gradient(
    device: Device, dtype: torch.dtype, tolerance: float
) -> None:
    """torch leaves parameters, moments and step count alone where `grad` is None; so does `skip`."""
    model = make_model(device, dtype)
    optimizer = Adam(model)
    leaves, twin = twin_of(model)
    plan = [("means",), (), ("sh", "quaternions"), tuple(PARAMETER_GROUPS), ("sh_rest", "means")]
    for step in range(30):
        gradients, skip = gradients_for(model, step), plan[step % 5]
        model.gradients.rows.write(gradients)
        before, moments = model.parameters.read().clone(), optimizer.state()
        optimizer.step(RATES, active_sh_degree=3, skip=skip)
        for leaf, (name, span) in zip(leaves, PARAMETER_GROUPS.items(), strict=True):
            skipped = name in skip or (name.startswith("sh") and "sh" in skip)
            leaf.grad = None if skipped else gradients[slice(*span)].clone()
            rows = slice(*span)
            assert torch.equal(model.parameters.read()[rows], before[rows]) == skipped, name
            for kind in ("first_moments", "second_moments"):
                same = torch.equal(optimizer.state()[kind][rows], moments[kind][rows])
                assert same == skipped, (name, kind)
        twin.step()
    torch.testing.assert_close(
        model.parameters.read(), torch.cat(leaves).detach(), rtol=tolerance, atol=tolerance
    )
    assert optimizer.state()["steps"].tolist() == [12, 24, 18, 24, 18, 12]
    assert optimizer.steps == 24


def test_more_gaussians_than_one_work_item_takes(device: Device) -> None:
    model = make_model(device, torch.float32, count=4096 + 21, degree=0)
    before = model.parameters.read().clone()
    optimizer = Adam(model)
    model.gradients.rows.write(torch.ones(model.rows, model.capacity))
    optimizer.step(RATES, active_sh_degree=0)
    # The first step of Adam moves every parameter by its learning rate.
    moved = (before - model.parameters.read())[:, : model.count]
    for name, span in PARAMETER_GROUPS.items():
        rows = moved[slice(*span)]
        torch.testing.assert_close(rows, torch.full_like(rows, RATES[name]), rtol=2e-3, atol=5e-7)


def test_resetting_one_groups_moments_leaves_the_others(device: Device) -> None:
    model = make_model(device, torch.float32)
    optimizer = Adam(model)
    model.gradients.rows.write(gradients_for(model, 5))
    optimizer.step(RATES, active_sh_degree=3)
    before = optimizer.state()
    optimizer.reset_moments("opacity_logits")
    after = optimizer.state()
    for moments in ("first_moments", "second_moments"):
        assert (before[moments][10] != 0).any()
        assert (after[moments][10] == 0).all()
        others = [row for row in range(model.rows) if row != 10]
        assert torch.equal(after[moments][others], before[moments][others])


def test_a_restored_optimizer_continues_with_the_same_bits(device: Device) -> None:
    def run(interrupted: bool) -> Tensor:
        model = make_model(device, torch.float32)
        optimizer = Adam(model)
        for step in range(6):
            if interrupted and step == 3:
                state = optimizer.state()
                optimizer = Adam(model)
                optimizer.restore(state)
            model.gradients.rows.write(gradients_for(model, step))
            optimizer.step(RATES, active_sh_degree=3, skip=("means",) if step == 1 else ())
        return model.parameters.read().clone()

    assert torch.equal(run(interrupted=True), run(interrupted=False))


def test_invalid_names_and_states_raise(device: Device) -> None:
    model = make_model(device, torch.float32)
    optimizer = Adam(model)
    with pytest.raises(ExplainedError, match="sh_rest"):
        optimizer.step({k: v for k, v in RATES.items() if k != "sh_rest"}, 3)
    with pytest.raises(ExplainedError, match="'sh'"):
        optimizer.reset_moments("sh")
    with pytest.raises(ExplainedError, match="'scales'"):
        optimizer.step(RATES, 3, skip={"scales"})
    assert optimizer.steps == 0
    other = Adam(make_model(device, torch.float32, count=5)).state()
    with pytest.raises(ExplainedError, match="first_moments"):
        optimizer.restore(other)
    with pytest.raises(ExplainedError, match="steps"):
        optimizer.restore({k: v for k, v in optimizer.state().items() if k != "steps"})
