"""Schedules written as a share of the run."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.pipeline.schedule import in_iterations
from registry.pipeline.yaml_source import Node, Place
from tests.host import PipelineError, Plugins

TEXT = """\
name: shares
scene: toy_scene
initializer: toy_points
densification: {use: toy_growth, start: 10%, stop: 49.9%, every: 100}
training: {iterations: 30000}
"""


def parse(plugins: Plugins, *overrides: str) -> Pipeline:
    return parse_pipeline(TEXT, plugins, overrides=overrides)


def test_a_share_follows_the_number_of_iterations(toys: Plugins) -> None:
    (item,) = parse(toys).items["densification"]
    assert (item.schedule.start, item.schedule.stop) == (3000, 14970)
    (item,) = parse(toys, "training.iterations=50").items["densification"]
    assert (item.schedule.start, item.schedule.stop) == (5, 24)


@given(st.integers(0, 1000), st.integers(1, 100_000))
def test_a_share_is_exact(tenths: int, iterations: int) -> None:
    written = {"stop": Node(f"{tenths // 10}.{tenths % 10}%", Place("a.yaml", 1))}
    stop = in_iterations(written, iterations)["stop"].content
    assert stop == max(1, tenths * iterations // 1000)


def test_a_share_without_a_fraction_is_exact(toys: Plugins) -> None:
    changes = ("densification.stop=57%", "training.iterations=10000")
    assert parse(toys, *changes).items["densification"][0].schedule.stop == 5700


def test_every_may_be_a_share(toys: Plugins) -> None:
    often = "densification.every=10%"
    assert parse(toys, often).items["densification"][0].schedule.every == 3000
    (item,) = parse(toys, often, "training.iterations=5").items["densification"]
    assert item.schedule.every == 1, "at most in each iteration"


def test_the_resolved_pipeline_holds_plain_iterations(toys: Plugins) -> None:
    pipeline = parse(toys)
    assert "%" not in pipeline.to_yaml()
    assert parse_pipeline(pipeline.to_yaml(), toys) == pipeline


def test_what_is_no_share_is_refused(toys: Plugins) -> None:
    with pytest.raises(PipelineError, match="must be a whole number"):
        parse(toys, "densification.stop=half")


def test_a_moment_after_the_end_is_refused(toys: Plugins) -> None:
    with pytest.raises(PipelineError, match="150% of the iterations, more than there are"):
        parse_pipeline(TEXT.replace("10%", "150%"), toys)


def test_a_run_too_short_for_a_share_does_without_the_component(toys: Plugins) -> None:
    text = TEXT.replace("start: 10%", "start: 600")
    short = parse_pipeline(text, toys, overrides=["training.iterations=1000"])
    assert short.items["densification"] == ()
    long = parse_pipeline(text, toys, overrides=["training.iterations=2000"])
    assert long.items["densification"][0].schedule.stop == 998
