"""A pipeline at another length has its moments where they were; the scene may have a say in the length."""

from __future__ import annotations

import pytest

from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.pipeline.training_settings import VIEWS, iterations_of_a_run
from tests.host import PipelineError, Plugins

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


def pipeline(toys: Plugins, *overrides: str) -> Pipeline:
    return parse_pipeline(TEXT, toys, overrides=overrides)


def per_view(toys: Plugins, *overrides: str) -> Pipeline:
    return pipeline(toys, "training.iterations=200 per view", *overrides)


def test_moments_move_with_the_length(toys: Plugins) -> None:
    half = pipeline(toys).scaled(200)
    growth, fade = half.items["densification"][0].host, half.items["opacity"][0].host
    assert (growth.start, growth.every, growth.phase, growth.stop) == (50, 50, 15, 140)
    assert fade.start == 200
    assert (half.training.iterations, half.training.sh_every) == (200, 100)
    assert half.training.learning_rates.position_steps == 150


def test_what_holds_for_each_iteration_stays(toys: Plugins) -> None:
    for iterations in (3, 200, 4000):
        changed = pipeline(toys).scaled(iterations)
        for section in ("regularizers", "modifiers"):
            host = changed.items[section][0].host
            assert (host.start, host.every, host.stop) == (1, 1, None)


def test_no_moment_vanishes_in_a_short_run(toys: Plugins) -> None:
    short = pipeline(toys).scaled(2)
    growth = short.items["densification"][0].host
    assert (growth.start, growth.every, growth.stop) == (1, 1, 1)
    assert short.training.sh_every == 1


def test_its_own_length_is_the_pipeline_itself(toys: Plugins) -> None:
    assert pipeline(toys).scaled(400).to_yaml() == pipeline(toys).to_yaml()


def test_it_is_written_and_read_like_any_other(toys: Plugins) -> None:
    changed = pipeline(toys).scaled(123)
    assert parse_pipeline(changed.to_yaml(), toys).to_yaml() == changed.to_yaml()


def test_each_view_may_bring_iterations(toys: Plugins) -> None:
    for views in (1, VIEWS, 9):
        found = per_view(toys).for_views(views)
        assert found.training.iterations == 200 * views
        assert found.items["densification"][0].host.stop == 140 * views
        assert found.iterations_per_view is None
        assert found.for_views(2 * views) is found


def test_what_the_views_bring_scales_all_moments(toys: Plugins) -> None:
    """As if the pipeline had been written for `VIEWS` of them."""
    written = pipeline(toys, f"training.iterations={200 * VIEWS}")
    assert per_view(toys).for_views(8).to_yaml() == written.scaled(1600).to_yaml()


def test_a_number_leaves_the_scene_no_say(toys: Plugins) -> None:
    assert pipeline(toys).for_views(9) == pipeline(toys)
    assert per_view(toys, "training.iterations=7").for_views(9).training.iterations == 7


def test_iterations_for_each_view_are_written_so(toys: Plugins) -> None:
    text = per_view(toys).to_yaml()
    assert "  iterations: 200 per view\n" in text
    again = parse_pipeline(text, toys)
    assert (again.to_yaml(), again.iterations_per_view) == (text, 200)


RATES = ("position", "position_final", "sh_constant", "sh_rest", "opacity", "scale", "rotation")


@pytest.mark.parametrize(("views", "share"), [(1, 1), (6, 1), (12, 1 / 2), (24, 1 / 4)])
def test_many_views_take_more_and_shorter_steps(toys: Plugins, views: int, share: float) -> None:
    asked = per_view(toys, "training.learning_rates.views=6")
    written = asked.training.learning_rates
    found = asked.for_views(views).training.learning_rates
    for name in RATES:
        assert getattr(found, name) == pytest.approx(share * getattr(written, name), rel=1e-12)
    assert (found.final_share, found.views) == (written.final_share, None)


@pytest.mark.parametrize(("views", "most"), [(3, 1000), (24, 1000), (36, 1500), (300, 12500)])
def test_many_views_may_have_more_gaussians(toys: Plugins, views: int, most: int) -> None:
    asked = per_view(toys, "training.max_gaussians=1000")
    assert asked.for_views(views).training.max_gaussians == most


def test_rates_hold_for_any_number_of_views_unless_it_is_said(toys: Plugins) -> None:
    asked = per_view(toys)
    assert "views" not in asked.plain()["training"]["learning_rates"]
    rates = asked.for_views(40).training.learning_rates
    assert [getattr(rates, name) for name in RATES] == [
        getattr(asked.training.learning_rates, name) for name in RATES
    ]


def test_the_number_of_views_of_the_rates_is_written(toys: Plugins) -> None:
    text = per_view(toys, "training.learning_rates.views=6").to_yaml()
    assert "    views: 6\n" in text
    assert parse_pipeline(text, toys).to_yaml() == text


def test_a_pipeline_knows_what_its_runs_wrote(toys: Plugins) -> None:
    rates_too = per_view(toys, "training.learning_rates.views=3")
    for asked in (per_view(toys), pipeline(toys), rates_too):
        wrote = asked.for_views(5).to_yaml()
        assert asked.wrote(wrote)
        assert not asked.wrote(wrote.replace("sh_every", "sh_never"))
        assert not asked.wrote(asked.scaled(77).to_yaml())
        assert not asked.wrote("")


@pytest.mark.parametrize("text", ["100 per image", "0 per view", "many", "99999999999 per view"])
def test_other_words_are_no_length(toys: Plugins, text: str) -> None:
    with pytest.raises(PipelineError, match=f"iterations must be a whole number, not '{text}'"):
        pipeline(toys, f"training.iterations={text}")


def test_a_component_may_have_iterations_of_its_own(toys: Plugins) -> None:
    """In the pipeline file of a run they stand before those of the training."""
    text = per_view(toys).for_views(5).to_yaml()
    assert iterations_of_a_run(text) == 1000
    assert (
        iterations_of_a_run(text.replace("initializer:\n", "initializer:\n  iterations: 7\n"))
        == 1000
    )
    assert (
        iterations_of_a_run(text.replace("priors: []\n", "priors:\n- use: one\n  iterations: 7\n"))
        == 1000
    )
    assert iterations_of_a_run("training: none") == 0
