"""One component class, tried."""

from __future__ import annotations

import json
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Device, open_device

from ..contract.component import Component, Context, Settings
from ..contract.hook_points import HOOK_POINTS
from ..contract.prior import Prior
from ..plugins import check_offer
from ..training.component_parameters import check_groups
from .bench import Bench
from .judging import require, same
from .questions import ASK


def check(
    component: type[Component[Any]],
    *,
    priors: dict[str, Prior[Any]] | None = None,
    device: Device | None = None,
    **settings: Any,
) -> None:
    """Try one component class; a fault raises with a message that says which.

    Args:
        priors: what `Step.priors` and `initialize` are given.
        device: where the Gaussians live; None chooses.
        settings: for the component, as Python values.

    Raises:
        AssertionError: the component breaks the contract.
        ExplainedError: the host or the engine would refuse the class or an answer.
    """
    point = next((p for p in HOOK_POINTS if issubclass(component, p.base)), None)
    require(point is not None, f"{component.__name__} derives from none of the component bases")
    assert point is not None
    check_offer(point, "conformance", component)
    chosen = component.Settings(**settings)
    _check_settings(chosen)
    bench = Bench(device or open_device(), priors or {})
    answers = []
    for _ in range(2):
        built = component(chosen, Context("conformance", 7, bench.device))
        answers.append(ASK[point.section](bench, built))
        check_groups(built.parameters())
        _check_state(component, chosen, built, bench)
    require(
        same(*answers), f"two {point.title}s with one seed gave different answers to one question"
    )


def _check_settings(settings: Settings) -> None:
    again = type(settings).model_validate_json(
        json.dumps(settings.model_dump(mode="json")), strict=True
    )
    require(again == settings, "the settings do not survive being written to a pipeline file")


def _check_state(
    component: type[Component[Any]], settings: Settings, built: Component[Any], bench: Bench
) -> None:
    """Saved and restored state must be equal; every kind of edit must be followed."""
    count = bench.model().count
    pruned = torch.arange(1, count)
    built.carry(pruned, torch.zeros(len(pruned), dtype=torch.bool))
    moved = torch.cat(
        [torch.full((2,), count - 2), torch.arange(2, count - 1), torch.zeros(5).long()]
    )
    built.carry(moved, torch.arange(len(moved)).lt(2) | torch.arange(len(moved)).ge(count - 1))
    state = built.state()
    for name, value in state.items():
        require(isinstance(value, Tensor), f"state()[{name!r}] is not a tensor")
    other = component(settings, Context("conformance", 7, bench.device))
    other.restore({name: value.clone() for name, value in state.items()})
    require(same(other.state(), state), "restore() does not bring back what state() returned")
