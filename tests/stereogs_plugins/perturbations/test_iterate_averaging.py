from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from core_rasterizer import GaussianModel
from registry import Step
from registry.testing import check
from stereogs_plugins.perturbations.iterate_averaging import (
    PARAMETERS,
    IterateAveraging,
    stereogs_register_perturbations,
)
from tests.stereogs_plugins.building import build, moment_with, offered, some_gaussians


def begun() -> tuple[Step, GaussianModel]:
    step, model = moment_with(some_gaussians([0.1] * 3, [0.5] * 3))
    return replace(step, iterations=step.iteration + 3), model


def wander(
    averaging: IterateAveraging, step: Step, model: GaussianModel
) -> dict[str, list[Tensor]]:
    """Four iterations, the run's last, before each of which everything moves; what it was in each."""
    draw = torch.Generator().manual_seed(0)
    seen: dict[str, list[Tensor]] = {name: [] for name in PARAMETERS}
    for later in range(4):
        for name in PARAMETERS:
            value = model.read(name)
            model.write(name, value + torch.randn(value.shape, generator=draw))
            seen[name].append(model.read(name))
        offsets = averaging.offsets(replace(step, iteration=step.iteration + later))
        assert (later == 3) == bool(offsets)
        for name, offset in offsets.items():
            model.write(name, model.read(name) + offset)
    return seen


def test_is_offered_as_iterate_averaging_and_keeps_the_contract() -> None:
    assert offered(stereogs_register_perturbations) == {"iterate_averaging": IterateAveraging}
    check(IterateAveraging)


def test_it_ends_in_the_mean_of_the_iterations_it_was_due_in() -> None:
    step, model = begun()
    for name, values in wander(build(IterateAveraging), step, model).items():
        torch.testing.assert_close(model.read(name), torch.stack(values).mean(dim=0))


def test_after_a_change_of_topology_it_begins_anew() -> None:
    step, model = begun()
    averaging = build(IterateAveraging)
    averaging.offsets(replace(step, iterations=1000))
    averaging.carry(torch.arange(3), torch.zeros(3, dtype=torch.bool))
    for name, values in wander(averaging, step, model).items():
        torch.testing.assert_close(model.read(name), torch.stack(values).mean(dim=0))
