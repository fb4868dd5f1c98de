from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry import HostDefaults, OtherField, Percent, PluginError, Step
from stereogs_plugins.densification.co_pruning import CoPruning
from tests.host import TrainingSettings, pipeline_item, pipeline_of, refuse_unmet_needs
from tests.stereogs_plugins.building import build, step_with


def test_the_default_schedule() -> None:
    assert CoPruning.host_defaults == HostDefaults(start=Percent(10), every=Percent(5))


def at(positions: Tensor) -> Gaussians:
    count = len(positions)
    return Gaussians.from_points(
        positions,
        torch.full((count, 3), 0.5),
        torch.full((count,), 0.1),
        torch.full((count,), 0.5),
        0,
    )


def step_beside(own: Tensor, *others: Tensor) -> Step:
    step = step_with(at(own))
    beside = []
    for index, positions in enumerate(others, start=1):
        model = GaussianModel(at(positions), open_device())
        beside.append(OtherField(index, model.reader(), step.rendering, step.render))
    rendering = step.rendering
    step.rendered(lambda: rendering, tuple(beside))
    return step


def test_what_has_nothing_within_the_distance_goes() -> None:
    generator = torch.Generator().manual_seed(2)
    place = torch.tensor([0.0, 0.0, 20.0])
    own, one, two = (12 * torch.rand(60, 3, generator=generator) + place for _ in range(3))
    # CoR-GS's 5 on LLFF is too wide for so dense a cloud to lose anything.
    for distance in (1.5, 5.0):
        edit = build(CoPruning, distance=distance).refine(step_beside(own, one, two))
        near = [(torch.cdist(own, other).amin(dim=1) < distance) for other in (one, two)]
        assert edit.prune is not None
        assert torch.equal(edit.prune, ~(near[0] & near[1]))
    assert edit.prune is not None
    assert not edit.prune.any()


def test_the_order_in_which_two_fields_are_pruned_changes_nothing() -> None:
    generator = torch.Generator().manual_seed(5)
    first, second = (6 * torch.rand(80, 3, generator=generator) for _ in range(2))
    policy = build(CoPruning, distance=0.8)
    gone = policy.refine(step_beside(second, first)).prune
    without = policy.refine(step_beside(first, second)).prune
    assert gone is not None
    assert without is not None
    assert 0 < int(gone.sum()) < 80
    later = policy.refine(step_beside(second, first[~without])).prune
    assert later is not None
    assert torch.equal(later, gone)


def test_a_single_field_and_fields_without_anything_in_common_are_refused() -> None:
    policy = build(CoPruning, distance=0.5)
    one = pipeline_of([pipeline_item(CoPruning, policy.settings, "pruning")], TrainingSettings())
    with pytest.raises(PluginError, match="training has a single field"):
        refuse_unmet_needs(one)
    with pytest.raises(PluginError, match=r"counterpart within 0\.5"):
        policy.refine(step_beside(torch.zeros(3, 3), torch.full((3, 3), 9.0)))
