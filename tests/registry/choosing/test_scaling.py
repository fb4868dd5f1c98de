"""A pipeline at another length has its moments where they were, as parts of the run."""

from __future__ import annotations

from registry.choosing.scaling import scaled
from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.plugins.discovery import Plugins

TEXT = """\
name: toy
scene: {use: toy_scene, path: here}
initializer: toy_points
regularizers: [toy_term]
modifiers: [toy_dropout]
densification: {use: toy_growth, start: 100, every: 100, phase: 30, stop: 70%}
opacity: {use: toy_fade, start: 100%}
training: {iterations: 400, sh_every: 200, learning_rates: {position_steps: 300}}
"""


def pipeline(toys: Plugins) -> Pipeline:
    return parse_pipeline(TEXT, toys)


def test_moments_move_with_the_length(toys: Plugins) -> None:
    half = scaled(pipeline(toys), 200)
    growth, fade = half.items["densification"][0].host, half.items["opacity"][0].host
    assert (growth.start, growth.every, growth.phase, growth.stop) == (50, 50, 15, 140)
    assert fade.start == 200
    assert (half.training.iterations, half.training.sh_every) == (200, 100)
    assert half.training.learning_rates.position_steps == 150


def test_what_holds_for_each_iteration_stays(toys: Plugins) -> None:
    for iterations in (3, 200, 4000):
        changed = scaled(pipeline(toys), iterations)
        for section in ("regularizers", "modifiers"):
            host = changed.items[section][0].host
            assert (host.start, host.every, host.stop) == (1, 1, None)


def test_no_moment_vanishes_in_a_short_run(toys: Plugins) -> None:
    short = scaled(pipeline(toys), 2)
    growth = short.items["densification"][0].host
    assert (growth.start, growth.every, growth.stop) == (1, 1, 1)
    assert short.training.sh_every == 1


def test_its_own_length_is_the_pipeline_itself(toys: Plugins) -> None:
    assert scaled(pipeline(toys), 400).to_yaml() == pipeline(toys).to_yaml()


def test_it_is_written_and_read_like_any_other(toys: Plugins) -> None:
    changed = scaled(pipeline(toys), 123)
    assert parse_pipeline(changed.to_yaml(), toys).to_yaml() == changed.to_yaml()
