"""Relocation: equation 9 of 3DGS-MCMC; Gaussians, moments and images afterwards."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    Edit,
    GaussianError,
    GaussianModel,
    Gaussians,
    Relocation,
    apply_edit,
)
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.optimization.topology import shared_among_copies
from tests.core_rasterizer.test_topology import generator, mask, trained


def equation_9(opacity: float, copies: int) -> tuple[float, float]:
    """New opacity and factor of the scales, term by term as the paper has it."""
    new = 1 - (1 - opacity) ** (1 / copies)
    total = 0.0
    for i in range(1, copies + 1):
        for k in range(i):
            total += math.comb(i - 1, k) * (-1) ** k * new ** (k + 1) / math.sqrt(k + 1)
    return new, opacity / total


@pytest.mark.parametrize("copies", [1, 2, 3, 7, 51])
def test_the_formula_is_the_papers(copies: int) -> None:
    opacities = torch.tensor([1e-3, 0.005, 0.1, 0.5, 0.9, 0.999], dtype=torch.float64)
    logits, factors = shared_among_copies(torch.logit(opacities), torch.full((6,), copies))
    expected = torch.tensor([equation_9(o, copies) for o in opacities.tolist()])
    torch.testing.assert_close(logits.sigmoid(), expected[:, 0].double(), rtol=1e-6, atol=0)
    torch.testing.assert_close(factors.exp(), expected[:, 1].double(), rtol=1e-6, atol=0)
    for o, new, factor in zip(opacities.tolist(), logits.sigmoid(), factors.exp(), strict=True):
        assert new.item() == pytest.approx(equation_9(o, copies)[0], rel=1e-10)
        assert factor.item() == pytest.approx(equation_9(o, copies)[1], rel=1e-9)


def test_each_source_has_its_own_number_of_copies() -> None:
    together = shared_among_copies(torch.tensor([0.3, -1.0, 2.0]), torch.tensor([2, 40, 5]))
    for index, (logit, copies) in enumerate(((0.3, 2), (-1.0, 40), (2.0, 5))):
        alone = shared_among_copies(torch.tensor([logit]), torch.tensor([copies]))
        for one, all_ in zip(alone, together, strict=True):
            assert one.item() == pytest.approx(all_[index].item(), rel=1e-12)


@pytest.mark.parametrize("logit", [-1e30, -100.0, 20.0, 1e30])
@pytest.mark.parametrize("copies", [2, 51, 100_000])
def test_any_opacity_and_any_number_of_copies_stay_finite(logit: float, copies: int) -> None:
    """The alternating sum keeps its digits: the factor lies where the paper's does, above sqrt(o / n)."""
    logits, factors = shared_among_copies(torch.tensor([logit]), torch.tensor([copies]))
    assert torch.isfinite(logits).all()
    assert logits.item() < max(-15, min(logit, 16))
    assert -math.log(copies) < factors.item() <= 1e-6


def test_sources_and_targets_share_and_reset_their_moments(device: Device) -> None:
    model, optimizer = trained(device)
    before = model.gaussians()
    moments = [
        m.read()[:, :50].clone() for m in (optimizer.first_moments, optimizer.second_moments)
    ]
    edit = Edit(relocate=move(source=[4, 9, 4], target=[30, 2, 31]))
    carried = apply_edit(model, optimizer, edit, generator())

    source = torch.arange(50)
    source[[30, 2, 31]] = torch.tensor([4, 9, 4])
    assert torch.equal(carried.source, source)
    assert carried.fresh.nonzero()[:, 0].tolist() == [2, 30, 31]
    after = model.gaussians()
    for name in ("means", "quaternions", "sh"):
        assert torch.equal(getattr(after, name), getattr(before, name)[source]), name
    for index, copies in ((4, 3), (30, 3), (31, 3), (9, 2), (2, 2)):
        old = source[index]
        opacity, factor = equation_9(before.opacity_logits[old].double().sigmoid().item(), copies)
        assert after.opacity_logits[index].sigmoid().item() == pytest.approx(opacity, rel=1e-5)
        scales = before.log_scales[old].exp() * factor
        torch.testing.assert_close(after.log_scales[index].exp(), scales, rtol=1e-5, atol=0)
    others = [i for i in range(50) if i not in (2, 4, 9, 30, 31)]
    for name in PARAMETERS:
        assert torch.equal(getattr(after, name)[others], getattr(before, name)[others]), name
    for moved, old in zip(
        (optimizer.first_moments, optimizer.second_moments), moments, strict=True
    ):
        assert torch.equal(moved.read()[:, others], old[:, others])
        assert not moved.read()[:, [2, 4, 9, 30, 31]].any()


def picture(gaussians: Gaussians, device: Device) -> Tensor:
    camera = Camera(torch.eye(4), 100.0, 100.0, 32.0, 32.0, 64, 64)
    with torch.no_grad():
        return GaussianModel(gaussians, device).render(camera).rgb


@pytest.mark.parametrize("copies", [2, 6])
def test_the_image_stays_nearly_the_same(device: Device, copies: int) -> None:
    """One Gaussian alone; a plain copy, or eq. 9's opacity without its scales, changes far more."""
    gaussians = Gaussians.from_points(
        torch.tensor([[0.0, 0.0, 2.0]] + [[0.0, 0.0, -5.0]] * (copies - 1)),
        torch.full((copies, 3), 0.8),
        torch.full((copies,), 0.12),
        torch.full((copies,), 0.7),
        sh_degree=0,
    )
    before = picture(gaussians, device)
    model = GaussianModel(gaussians, device)
    targets = torch.arange(1, copies)
    edit = Edit(relocate=Relocation(torch.zeros_like(targets), targets))
    apply_edit(model, Adam(model), edit, generator())
    relocated = model.gaussians()
    error = (picture(relocated, device) - before).abs().mean()
    assert error < 0.12 * before.mean()  # equation 9 is exact along a line, not in the plane
    relocated.log_scales[:] = gaussians.log_scales[0]
    assert (picture(relocated, device) - before).abs().mean() > 2 * error
    relocated.opacity_logits[:] = gaussians.opacity_logits[0]
    assert (picture(relocated, device) - before).abs().mean() > 8 * error


def test_a_relocation_without_targets_changes_nothing(device: Device) -> None:
    model, optimizer = trained(device)
    digest = model.digest()
    nothing = torch.zeros(0, dtype=torch.int64)
    edit = Edit(relocate=Relocation(nothing, nothing))
    assert edit.empty
    apply_edit(model, optimizer, edit, generator())
    assert model.digest() == digest


def move(source: list[int], target: list[int]) -> Relocation:
    return Relocation(torch.tensor(source), torch.tensor(target))


WRONG = {
    "a target twice": (move([1, 2], [7, 7]), None, "target", 0, "twice"),
    "a target that is a source": (move([1, 7], [3, 1]), None, "target", 1, "source"),
    "a target that is pruned": (move([1], [7]), mask(50, 7), "target", 0, "pruned"),
    "a source that is pruned": (move([1], [7]), mask(50, 1), "source", 0, "pruned"),
    "an index too large": (move([1], [50]), None, "target", 0, "50"),
    "an index below 0": (move([1, -1], [3, 4]), None, "source", 1, "-1"),
    "unequal lengths": (move([1, 2], [3]), None, "source", None, "expected"),
    "indices that are none": (
        Relocation(torch.tensor([1]), mask(50, 3)),
        None,
        "target",
        None,
        "int64",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_invalid_relocation_raises_and_changes_nothing(device: Device, case: str) -> None:
    relocation, prune, field, index, what = WRONG[case]
    model, optimizer = trained(device)
    digest, state = model.digest(), optimizer.state()
    with pytest.raises(GaussianError, match=what) as error:
        apply_edit(model, optimizer, Edit(relocate=relocation, prune=prune), generator())
    assert (error.value.field, error.value.index) == (f"relocate.{field}", index)
    assert model.digest() == digest
    assert all(torch.equal(values, state[name]) for name, values in optimizer.state().items())
