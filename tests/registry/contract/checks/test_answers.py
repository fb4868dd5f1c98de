"""Numbers per Gaussian that are out of range are refused by the first Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from registry import OpacityUpdate, PluginError
from registry.contract.checks.answers import check_opacity_scale, check_opacity_update

Check = Callable[[torch.Tensor, Any], object]


def _opacities(values: torch.Tensor, step: Any) -> object:
    return check_opacity_update(OpacityUpdate(values), step)


@pytest.mark.parametrize(
    ("check", "wrong"),
    [(check_opacity_scale, -0.1), (_opacities, -0.1), (_opacities, 1.1), (_opacities, torch.nan)],
)
def test_the_first_gaussian_out_of_range_is_named(check: Check, wrong: float) -> None:
    step = SimpleNamespace(model=SimpleNamespace(count=5))
    values = torch.tensor([0.0, 1.0, 0.5, 0.5, 0.5])
    check(values, step)
    values[3:] = wrong
    with pytest.raises(PluginError) as refused:
        check(values, step)
    assert refused.value.where == "Gaussian 3"


@pytest.mark.parametrize("check", [check_opacity_scale, _opacities])
def test_no_gaussians_pass(check: Check) -> None:
    check(torch.empty(0), SimpleNamespace(model=SimpleNamespace(count=0)))
