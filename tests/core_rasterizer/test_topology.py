"""Clone, split and prune: what stays, what comes, and what belongs to it."""

from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import Adam, Device, Edit, GaussianError, GaussianModel, apply_edit
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.optimization.topology import CHILDREN, SHRINK
from tests.core_rasterizer.test_model import parameters, view

RATES = dict.fromkeys(
    ("means", "sh_constant", "sh_rest", "opacity_logits", "log_scales", "quaternions"), 1e-3
)


def trained(device: Device, count: int = 50) -> tuple[GaussianModel, Adam]:
    """A model with one optimizer step behind it, so that moments are not zero."""
    model = GaussianModel(parameters(count), device)
    optimizer = Adam(model)
    model.render(view(), collect_statistics=True).rgb.square().sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    return model, optimizer


def mask(count: int, *indices: int) -> torch.Tensor:
    result = torch.zeros(count, dtype=torch.bool)
    result[list(indices)] = True
    return result


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def test_order_parameters_and_moments_after_an_edit(device: Device) -> None:
    model, optimizer = trained(device)
    before = model.gaussians()
    moments = optimizer.first_moments.read()[:, : model.count].clone()
    assert moments.abs().sum() > 0
    edit = Edit(clone=mask(50, 3, 7), split=mask(50, 7, 20), prune=mask(50, 7, 49))
    carried = apply_edit(model, optimizer, edit, generator())
    # 7 is pruned, whatever else was asked; 20 gives way to its children.
    stays = [i for i in range(50) if i not in (7, 20, 49)]
    assert carried.source.tolist() == [*stays, 3, 20, 20]
    assert carried.fresh.tolist() == [False] * len(stays) + [True] * 3
    assert model.count == len(stays) + 1 + CHILDREN
    after = model.gaussians()
    for name in PARAMETERS:
        values, old = getattr(after, name), getattr(before, name)
        assert torch.equal(values[: len(stays) + 1], old[[*stays, 3]]), name
        if name not in ("means", "log_scales"):
            assert torch.equal(values[-CHILDREN:], old[[20, 20]]), name
    shrunk = before.log_scales[[20, 20]] - math.log(SHRINK)
    assert torch.allclose(after.log_scales[-CHILDREN:], shrunk, atol=1e-6)
    moved = optimizer.first_moments.read()
    assert torch.equal(moved[:, : len(stays)], moments[:, stays])
    assert not moved[:, len(stays) :].any()
    assert not model.screen_gradient().any()


def test_children_are_drawn_from_their_parent(device: Device) -> None:
    """Sample mean and covariance of many children are those of the Gaussian."""
    gaussians = parameters(1)
    copies = 4000
    many = type(gaussians)(
        **{n: getattr(gaussians, n).repeat_interleave(copies, dim=0) for n in PARAMETERS}
    )
    model = GaussianModel(many, device)
    apply_edit(model, Adam(model), Edit(split=torch.ones(copies, dtype=torch.bool)), generator())
    offsets = (model.read("means") - gaussians.means).double()
    w, x, y, z = torch.nn.functional.normalize(gaussians.quaternions[0].double(), dim=0).tolist()
    rotation = torch.tensor(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
        dtype=torch.float64,
    )
    axes = rotation * gaussians.log_scales[0].double().exp()
    covariance = axes @ axes.T
    assert torch.allclose(
        offsets.T @ offsets / len(offsets), covariance, atol=0.06 * covariance.max()
    )
    assert offsets.mean(0).norm() < 0.05 * covariance.trace().sqrt()


def test_the_same_generator_gives_the_same_children(device: Device) -> None:
    digests = []
    for _ in range(2):
        model, optimizer = trained(device)
        apply_edit(model, optimizer, Edit(split=mask(50, 1, 2, 3)), generator())
        digests.append(model.digest())
    assert digests[0] == digests[1]


def test_growth_beyond_the_capacity_and_training_after_it(device: Device) -> None:
    model, optimizer = trained(device)
    for _ in range(3):
        apply_edit(
            model, optimizer, Edit(clone=torch.ones(model.count, dtype=torch.bool)), generator()
        )
    assert model.count == 400
    model.render(view()).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    assert torch.isfinite(model.read("means")).all()


def test_all_but_one_may_go_but_not_all(device: Device) -> None:
    model, optimizer = trained(device)
    apply_edit(model, optimizer, Edit(prune=~mask(50, 31)), generator())
    assert model.count == 1
    with pytest.raises(GaussianError, match="remove all"):
        apply_edit(model, optimizer, Edit(prune=mask(1, 0)), generator())
    assert model.count == 1


def test_a_mask_of_another_shape_is_refused(device: Device) -> None:
    model, optimizer = trained(device)
    with pytest.raises(GaussianError, match="expected") as error:
        apply_edit(model, optimizer, Edit(clone=mask(49, 1)), generator())
    assert error.value.field == "clone"
