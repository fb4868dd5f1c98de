"""Whom `known_depth` asks, and how often."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from registry import PluginError
from stereogs_plugins.regularizers.known_depth.estimate import Farness
from tests.stereogs_plugins.initializers.depth_scenes import prior_of
from tests.stereogs_plugins.regularizers.known_depth.steps import FixedInverseDepth, step_with_depth


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")


def test_a_monocular_prior_is_asked_first_and_once_a_view() -> None:
    nearness = torch.rand(4, 5)
    step = step_with_depth(torch.ones(4, 5), inverse_depth=nearness)
    mono = step.priors["mono"]
    assert isinstance(mono, FixedInverseDepth)
    step = replace(step, priors={"depth": prior_of(lambda view: torch.ones(4, 5)), "mono": mono})
    farness = Farness(None)
    for _ in range(3):
        values, known = farness.of(step)
        assert torch.equal(values, -nearness)
        assert known.all()
    assert mono.asked == 1


def test_a_multi_view_prior_answers_with_its_depth_where_it_knows_it() -> None:

    depth = torch.tensor([[2.0, 0.0], [3.0, 4.0]])
    step = step_with_depth(torch.ones(2, 2), inverse_depth=torch.ones(2, 2))
    first = step.view
    step = replace(step, scene=replace(step.scene, train=(first, replace(first, name="other"))))
    step = replace(step, priors={**step.priors, "depth": prior_of(lambda view: depth)})
    values, known = Farness("depth").of(step)
    assert torch.equal(values, depth)
    assert known.tolist() == [[True, False], [True, True]]


def test_what_a_photograph_leaves_empty_or_partly_so_has_no_depth() -> None:
    step = step_with_depth(torch.ones(2, 2), inverse_depth=torch.ones(2, 2))
    alpha = torch.tensor([[0.5, 1.0], [1.0, 0.0]])
    view = replace(step.view, alpha=alpha)
    step = replace(step, sample=replace(step.sample, view=view))
    step = replace(step, scene=replace(step.scene, train=(view, replace(view, name="other"))))
    assert Farness(None).of(step)[1].tolist() == [[False, True], [True, False]]
    depth = torch.tensor([[2.0, 0.0], [3.0, 4.0]])
    step = replace(step, priors={"depth": prior_of(lambda view: depth)})
    assert Farness("depth").of(step)[1].tolist() == [[False, False], [True, False]]


def test_without_a_prior_the_error_says_what_is_missing() -> None:
    step = step_with_depth(torch.ones(2, 2))
    with pytest.raises(PluginError, match="multi_view_depth"):
        Farness(None).of(step)
    with pytest.raises(PluginError, match="no prior named 'mono'"):
        Farness("mono").of(step)
