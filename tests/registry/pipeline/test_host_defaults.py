"""Defaults that a component declares for the settings that the host reads."""

from __future__ import annotations

from typing import Any

import pytest

from registry import Component, HostDefaults, Percent
from registry.pipeline.pipeline import Item, parse_pipeline
from tests.host import PipelineError, Plugins
from tests.registry.toy_plugin import ToyGrowth, ToyTerm

TEXT = "name: t\nscene: toy_scene\ninitializer: toy_points\n"


@pytest.fixture(autouse=True)
def _defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    growth = HostDefaults(start=Percent(2), stop=Percent(50), every=100, phase=0)
    monkeypatch.setattr(ToyGrowth, "host_defaults", growth)
    monkeypatch.setattr(ToyTerm, "host_defaults", HostDefaults(weight=0.1))


def growth(toys: Plugins, written: str, iterations: int = 3000) -> Item:
    text = f"{TEXT}densification: {written}\ntraining: {{iterations: {iterations}}}\n"
    pipeline = parse_pipeline(text, toys)
    assert parse_pipeline(pipeline.to_yaml(), toys) == pipeline, "the file of a run says all"
    (item,) = pipeline.items["densification"]
    return item


@pytest.mark.parametrize(
    ("iterations", "first", "last"), [(400, 100, 200), (3000, 100, 1500), (30_000, 600, 15_000)]
)
def test_a_bare_name_follows_the_length(
    toys: Plugins, iterations: int, first: int, last: int
) -> None:
    due = growth(toys, "toy_growth", iterations).schedule.due_in(iterations)
    assert (due[0], due[-1]) == (first, last)


@pytest.mark.parametrize(
    ("written", "first", "second", "last"),
    [
        (
            "start: 550",
            550,
            650,
            1450,
        ),  # the written start is the first, whatever the default phase
        ("every: 50", 100, 150, 1500),
        ("stop: 70%", 100, 200, 2100),
        ("stop: null", 100, 200, 3000),
        ("start: 60%", 1800, 1900, 3000),  # after the default stop, which does not apply
        ("{stop: 50, every: 10}", 10, 20, 50),  # before the default start, likewise
        ("start: 1, stop: null, every: 1, phase: 0", 1, 2, 3000),
    ],
)
def test_each_may_be_written(
    toys: Plugins, written: str, first: int, second: int, last: int
) -> None:
    item = growth(toys, f"{{use: toy_growth, {written.strip('{}')}}}")
    due = item.schedule.due_in(3000)
    assert (due[0], due[1], due[-1]) == (first, second, last)


def test_the_weight_is_one_of_them(toys: Plugins) -> None:
    text = f"{TEXT}regularizers: [toy_term, {{use: toy_term, name: full, weight: 1}}]\n"
    weights = [item.host.weight for item in parse_pipeline(text, toys).items["regularizers"]]
    assert weights == [0.1, 1.0]


def test_a_wrong_default_is_the_plugins_mistake(
    toys: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong: Any = "often"
    monkeypatch.setattr(ToyGrowth, "host_defaults", HostDefaults(every=wrong))
    with pytest.raises(PipelineError, match="whole number, not 'often'") as caught:
        growth(toys, "toy_growth")
    assert "host_defaults of densification 'toy_growth'" in caught.value.where


def test_without_defaults_a_component_is_always_due(
    toys: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain: Any = Component.host_defaults
    monkeypatch.setattr(ToyGrowth, "host_defaults", plain)
    assert len(growth(toys, "toy_growth").schedule.due_in(3000)) == 3000
