"""Clone, split and prune, with moments and statistics."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from core_rasterizer import (
    Adam,
    Device,
    Edit,
    GaussianError,
    GaussianModel,
    Relocation,
    apply_edit,
)
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import parameters, rates, view

RATES = rates(1e-3)


def trained(device: Device, count: int = 50) -> tuple[GaussianModel, Adam]:
    """A model after one optimizer step, with non-zero moments."""
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
    # 7 is pruned despite the other masks; 20 is replaced by its children.
    stays = [i for i in range(50) if i not in (7, 20, 49)]
    assert carried.source.tolist() == [*stays, 3, 20, 20]
    assert carried.fresh.tolist() == [False] * len(stays) + [True] * 3
    assert model.count == len(stays) + 1 + 2
    after = model.gaussians()
    for name in PARAMETERS:
        values, old = getattr(after, name), getattr(before, name)
        assert torch.equal(values[: len(stays) + 1], old[[*stays, 3]]), name
        if name not in ("means", "log_scales"):
            assert torch.equal(values[-2:], old[[20, 20]]), name
    shrunk = before.log_scales[[20, 20]] - math.log(1.6)
    assert torch.allclose(after.log_scales[-2:], shrunk, atol=1e-6)
    moved = optimizer.first_moments.read()
    assert torch.equal(moved[:, : len(stays)], moments[:, stays])
    assert not moved[:, len(stays) :].any()
    assert not model.statistics.screen_gradient().any()


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
        offsets.T @ offsets / len(offsets), covariance, atol=float(0.06 * covariance.max())
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


def test_a_split_may_have_more_children_that_shrink_otherwise(device: Device) -> None:
    model, optimizer = trained(device)
    before = model.gaussians()
    edit = Edit(split=mask(50, 8, 30), split_into=5, shrink=0.8 * 5)
    carried = apply_edit(model, optimizer, edit, generator())
    assert carried.source[48:].tolist() == [8, 30] * 5
    assert carried.fresh[48:].all()
    shrunk = before.log_scales[[8, 30] * 5] - math.log(4)
    assert torch.allclose(model.read("log_scales")[48:], shrunk, atol=1e-6)
    assert torch.equal(model.read("sh")[48:], before.sh[[8, 30] * 5])
    assert len(model.read("means")[48:].unique(dim=0)) == 10
    assert not optimizer.first_moments.read()[:, 48:58].any()


@pytest.mark.parametrize("number", [1, 70])
def test_added_ones_come_last_and_take_over_from_their_parents(device: Device, number: int) -> None:
    model, optimizer = trained(device)
    before, added = model.gaussians(), parameters(number, seed=9)
    parents = torch.arange(number) % 50
    carried = apply_edit(model, optimizer, Edit(add=added, parents=parents), generator())
    assert model.count == 50 + number
    assert torch.equal(carried.source, torch.cat([torch.arange(50), parents]))
    assert carried.fresh.tolist() == [False] * 50 + [True] * number
    for name in PARAMETERS:
        expected = torch.cat([getattr(before, name), getattr(added, name)])
        assert torch.equal(model.read(name), expected), name
    moments = optimizer.first_moments.read()
    assert moments[:, :50].any()
    assert not moments[:, 50:].any()


def test_everything_in_one_edit(device: Device) -> None:
    """Clones and children of relocated Gaussians use their new parameters."""
    model, optimizer = trained(device)
    optimizer.second_moments.fill(1)
    reference, other = trained(device)
    move = Relocation(source=torch.tensor([5, 6]), target=torch.tensor([40, 41]))
    clone, split, prune = mask(50, 5, 11), mask(50, 41, 12), mask(50, 13)
    added = parameters(3, seed=9)
    everything = Edit(clone, split, prune, 3, 2.0, added, torch.tensor([13, 0, 40]), move)
    carried = apply_edit(model, optimizer, everything, generator())

    stays = [i for i in range(50) if i not in (12, 13, 41)]
    source = [{40: 5}.get(i, i) for i in stays]
    assert carried.source.tolist() == [*source, 5, 11, *[12, 6] * 3, 13, 0, 40]
    assert carried.fresh.nonzero()[:, 0].tolist() == [stays.index(40), *range(47, 58)]
    restarted = (optimizer.second_moments.read()[:, :47] == 0).all(dim=0)
    assert restarted.nonzero()[:, 0].tolist() == [stays.index(i) for i in (5, 6, 40)]

    apply_edit(reference, other, Edit(relocate=move), generator())
    apply_edit(reference, other, Edit(clone, split, prune, 3, 2.0), generator())
    for name in PARAMETERS:
        expected = torch.cat([reference.read(name), getattr(added, name)])
        assert torch.equal(model.read(name), expected), name


def test_whatever_is_pruned_those_added_remain(device: Device) -> None:
    model, optimizer = trained(device)
    every = torch.ones(50, dtype=torch.bool)
    added = parameters(2, seed=9)
    edit = Edit(prune=every, add=added, parents=torch.tensor([3, 3]))
    carried = apply_edit(model, optimizer, edit, generator())
    assert carried.source.tolist() == [3, 3]
    assert torch.equal(model.read("means"), added.means)
    model.render(view()).rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)


def undefined() -> Any:
    gaussians = parameters(2)
    gaussians.sh[1, 0, 0] = math.nan
    return gaussians


PARENTS = torch.tensor([0, 1])
WRONG: dict[str, tuple[dict[str, Any], str, str]] = {
    "one child": ({"split_into": 1}, "split_into", "split_into is 1"),
    "too many children": ({"split_into": 1_000_000}, "split_into", "split_into is 1000000"),
    "half a child": ({"split_into": 2.5}, "split_into", "2.5"),
    "no size": ({"shrink": 0.0}, "shrink", "0.0"),
    "undefined size": ({"shrink": math.nan}, "shrink", "nan"),
    "no parents": ({"add": parameters(2)}, "parents", "without 'parents'"),
    "nobody added": ({"parents": PARENTS}, "add", "without 'add'"),
    "too few parents": ({"add": parameters(3), "parents": PARENTS}, "parents", "expected"),
    "unknown parents": ({"add": parameters(2), "parents": PARENTS + 49}, "parents", "50"),
    "other bands": ({"add": parameters(2, sh_degree=1), "parents": PARENTS}, "add", "degree 1"),
    "a value": ({"add": undefined(), "parents": PARENTS}, "sh", "not finite"),
    "no Gaussians": ({"add": PARENTS, "parents": PARENTS}, "add", "Tensor"),
    "no mask": ({"prune": [False] * 50}, "prune", "list"),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_invalid_edit_raises_and_changes_nothing(device: Device, case: str) -> None:
    fields, field, what = WRONG[case]
    model, optimizer = trained(device)
    digest, state = model.digest(), optimizer.state()
    with pytest.raises(GaussianError, match=what) as error:
        apply_edit(model, optimizer, Edit(**fields), generator())
    assert error.value.field == field
    assert model.digest() == digest
    assert model.statistics.screen_gradient().any()
    assert all(torch.equal(values, state[name]) for name, values in optimizer.state().items())


def test_only_an_edit_that_changes_nothing_is_empty() -> None:
    assert Edit().empty
    assert Edit(clone=mask(5), add=parameters(0), parents=PARENTS[:0]).empty
    assert not Edit(prune=mask(5, 3)).empty
    assert not Edit(add=parameters(2), parents=PARENTS).empty
    assert not Edit(relocate=Relocation(PARENTS[:1], PARENTS[1:])).empty
