"""The worked example on the page of methods is short, keeps the contract and does what it says."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from registry.testing import check
from tests.stereogs_plugins.building import build, moment_with, offered, some_gaussians

PAGE = Path(__file__).parents[3] / "docs" / "methods.md"
MODULE = "running_mean_of_the_page"


@pytest.fixture(scope="module")
def page() -> Any:
    """The example as a module."""
    (source,) = re.findall(r"^```py\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    assert len(source.splitlines()) < 60
    module = ModuleType(MODULE)
    sys.modules[MODULE] = module
    try:
        exec(compile(source, str(PAGE), "exec"), module.__dict__)
        yield module
    finally:
        del sys.modules[MODULE]


def test_it_is_offered_and_keeps_the_contract(page: Any) -> None:
    assert offered(page.stereogs_register_regularizers) == {"running_mean": page.RunningMean}
    check(page.RunningMean)


def test_it_pulls_back_to_the_running_mean(page: Any) -> None:
    step, model = moment_with(some_gaussians([0.1, 0.1], [0.5, 0.5]), extent=2.0)
    term = build(page.RunningMean, momentum=0.9)
    assert float(term.loss(step).detach()) == 0
    moved = model.read("means").clone()
    moved[1, 0] += 1
    model.write("means", moved)
    model.zero_gradients()
    loss = term.loss(step)
    # It moved by 1, its mean by 0.1; of six coordinates, in units of the extent.
    assert float(loss.detach()) == pytest.approx(0.9**2 / 2**2 / 6, rel=1e-5)
    loss.backward()
    gradient = model.gradient("means")
    assert float(gradient[1, 0]) == pytest.approx(2 * 0.9 / 2**2 / 6, rel=1e-5)
    assert int((gradient != 0).sum()) == 1


def test_new_gaussians_begin_where_they_are(page: Any) -> None:
    step, model = moment_with(some_gaussians([0.1, 0.1], [0.5, 0.5]))
    term = build(page.RunningMean, momentum=0.9)
    term.loss(step)
    term.carry(torch.tensor([0, 0]), torch.tensor([False, True]))
    moved = model.read("means").clone()
    moved[1] += 1
    model.write("means", moved)
    assert float(term.loss(step).detach()) == 0
