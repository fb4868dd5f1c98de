from __future__ import annotations

import logging
from typing import Any

import pytest
import torch

from core_rasterizer import Device, ExplainedError, GaussianError, GaussianModel
from registry import PluginError, RunError, Step
from registry.testing import tiny_scene
from registry.training.initial_model import initial_gaussians
from registry.training.trainer import Iteration, Trainer
from tests.host import Parts, Plugins, checked_plugins, parse_pipeline
from tests.registry.toy_plugin import ToyTerm

BASE = "name: t\nscene: toy_scene\ninitializer: toy_points\n"


@pytest.fixture
def make(toys: Plugins, device: Device) -> Any:
    def make(text: str, *overrides: str) -> Trainer:
        settings = ["training.iterations=12", "training.sh_degree=1", *overrides]
        pipeline = parse_pipeline(BASE + text, toys, source="p.yaml", overrides=settings)
        scene = tiny_scene()
        assert scene.points is not None
        model = GaussianModel(initial_gaussians(scene.points, pipeline.training), device)
        return Trainer(pipeline.training, Parts(pipeline, model.device), scene, model)

    return make


def poison(trainer: Trainer, rows: slice, columns: slice | list[int], value: float) -> None:
    """Write a value into parameters without the checks of `GaussianModel.write`."""
    model: Any = trainer.model
    parameters = model.parameters.read().clone()
    parameters[rows, columns] = value
    model.adopt(parameters, model.count)


def train(trainer: Trainer) -> list[Iteration]:
    return list(trainer.run())


def test_the_loss_falls_and_every_iteration_is_yielded(make: Any) -> None:
    trainer = make("", "training.iterations=60")
    before = trainer.model.digest()
    done = train(trainer)
    assert [d.number for d in done] == list(range(1, 61))
    early, late = (sum(d.loss for d in part) for part in (done[:10], done[-10:]))
    assert late < 0.7 * early
    assert trainer.model.digest() != before


def test_the_last_iteration_is_stepped(make: Any) -> None:
    trainer = make("", "training.iterations=1")
    before = trainer.model.digest()
    train(trainer)
    assert trainer.fields[0].optimizer.steps == 1
    assert trainer.model.digest() != before


FULL = """\
regularizers: [toy_term]
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 4}
opacity: {use: toy_fade, every: 3}
"""


def test_one_seed_one_result(make: Any) -> None:
    trainers = [make(FULL), make(FULL), make(FULL, "training.seed=1")]
    for trainer in trainers:
        train(trainer)
    digests = [trainer.model.digest() for trainer in trainers]
    assert digests[0] == digests[1]
    assert digests[0] != digests[2]


def test_a_component_does_not_change_random_numbers_of_others(make: Any) -> None:
    alone = make("modifiers: [toy_dropout]\n")
    beside = make("modifiers: [toy_dropout]\nregularizers: [{use: toy_term, weight: 1}]\n")
    draws = [
        torch.rand(4, generator=t.parts["modifiers"][0].component.generator)
        for t in (alone, beside)
    ]
    assert torch.equal(*draws)
    twins = make("regularizers: [toy_term, {use: toy_term, name: b}]\n").parts["regularizers"]
    first, second = (torch.rand(4, generator=part.component.generator) for part in twins)
    assert not torch.equal(first, second)


def test_schedules_and_weights_decide_who_is_called(make: Any) -> None:
    text = "regularizers: [{use: toy_term, start: 4, stop: 9, every: 2}]\n"
    calls = {d.number for d in train(make(text)) if "regularizers.toy_term" in d.logged}
    assert calls == {4, 6, 8}
    silent = train(make("regularizers: [{use: toy_term, weight: 0}]\n"))
    assert not any("regularizers.toy_term" in d.logged for d in silent)


def test_the_weight_multiplies_the_term(make: Any) -> None:
    (done,) = train(make("regularizers: [{use: toy_term, weight: 3}]\n", "training.iterations=1"))
    logged = done.logged
    expected = logged["photometric"] + 3 * logged["regularizers.toy_term"]
    assert done.loss == pytest.approx(expected, rel=1e-6)


def test_components_follow_changes_of_topology(make: Any) -> None:
    trainer = make(
        "regularizers: [toy_term]\ndensification: {use: toy_growth, start: 5, stop: 5}\n"
    )
    train(trainer)
    calls = trainer.parts["regularizers"][0].component.calls
    assert len(calls) == trainer.model.count
    # Survivors were there in all 12 iterations, clones and children in the last seven.
    assert set(calls.tolist()) == {7.0, 12.0}


def test_no_step_is_taken_with_gradients_from_before_an_edit(make: Any) -> None:
    trainer = make("densification: {use: toy_growth, every: 12}\n")
    train(trainer)
    assert trainer.fields[0].optimizer.steps == 11


def test_the_last_iteration_adds_nothing(make: Any) -> None:
    text = "densification: {use: toy_growth, prune: false, every: 6}\n"
    counts = [done.gaussians for done in train(make(text))]
    assert counts[4] < counts[5] == counts[-1]
    *before, last = train(make("densification: {use: toy_growth, start: 12}\n"))
    assert last.gaussians < before[-1].gaussians == before[0].gaussians  # removing is left


def test_an_empty_edit_costs_no_step(make: Any) -> None:
    trainer = make("densification: {use: toy_growth, empty: true, every: 12}\n")
    train(trainer)
    assert trainer.fields[0].optimizer.steps == 12


def test_opacities_are_kept_from_0_and_1(make: Any) -> None:
    trainer = make(
        "opacity: {use: toy_fade, value: 1.0}\n",
        "training.iterations=1",
        "training.learning_rates.opacity=0",
    )
    train(trainer)
    logits = trainer.model.read("opacity_logits")
    assert torch.isfinite(logits).all()
    torch.testing.assert_close(logits.sigmoid(), torch.full_like(logits, 1 - 1e-6))


def test_opacities_that_were_reset_take_no_step_from_earlier_gradients(make: Any) -> None:
    trainer = make("opacity: {use: toy_fade, value: 0.01, reset: true}\n", "training.iterations=1")
    train(trainer)
    torch.testing.assert_close(
        trainer.model.opacities(), torch.full((trainer.model.count,), 0.01), rtol=1e-5, atol=0
    )
    row = trainer.fields[0].optimizer.state()["second_moments"][10]
    assert not row.any()


@pytest.mark.parametrize(
    ("text", "message", "where"),
    [
        ("regularizers: [{use: toy_term, fault: nan}]", "the loss is not finite", "p.yaml:4"),
        ("regularizers: [{use: toy_term, fault: shape}]", "expected one floating", "p.yaml:4"),
        ("regularizers: [{use: toy_term, fault: crash}]", "ZeroDivisionError", "p.yaml:4"),
        ("regularizers: [{use: toy_term, fault: gradient}]", "undefined gradient", "p.yaml:4"),
        ("regularizers: [{use: toy_term, fault: backward}]", "no way back", "p.yaml:4"),
        ("densification: {use: toy_growth, wrong: true}", "clone", "p.yaml:4"),
        ("opacity: {use: toy_fade, value: 1.5}", "outside [0, 1]", "p.yaml:4"),
        ("opacity: {use: toy_fade, value: .nan}", "not finite", "p.yaml:4"),
    ],
)
def test_a_bad_answer_is_refused_before_the_step(
    make: Any, text: str, message: str, where: str
) -> None:
    trainer = make(text.replace("}", ", start: 3}") + "\n")
    iterations = trainer.run()
    next(iterations)
    next(iterations)
    before = trainer.model.digest()
    with pytest.raises(ExplainedError) as caught:
        next(iterations)
    assert message in caught.value.what
    assert where in caught.value.where
    assert "iteration 3" in caught.value.where
    assert trainer.model.digest() == before
    assert trainer.iteration == 2


@pytest.mark.parametrize(
    ("group", "value", "cause"),
    [
        ("sh", -10.0, "nearly all colours are 0 or less"),
        ("opacity_logits", -9.0, "all opacities are below 1/255"),
        ("means", 1e3, "no Gaussian is in it"),
    ],
)
def test_a_render_without_gradient_is_warned_of_once(
    make: Any, caplog: pytest.LogCaptureFixture, group: str, value: float, cause: str
) -> None:
    trainer = make("", "training.iterations=101")
    trainer.model.write(group, torch.full_like(trainer.model.read(group), value))
    train(trainer)
    (warning,) = caplog.messages
    assert warning.startswith("iteration 1, view ")
    assert f"the render has no gradient: {cause}" in warning


def test_a_render_with_gradient_is_not_warned_of(
    make: Any, caplog: pytest.LogCaptureFixture
) -> None:
    train(make(""))
    assert not caplog.messages


def test_a_term_stepped_alone_may_be_zero_without_a_gradient(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, alone = make(""), make("regularizers: [{use: toy_term, step: alone}]\n")
    monkeypatch.setattr(ToyTerm, "loss", lambda self, step: torch.zeros(()))
    for trainer in (plain, alone):
        train(trainer)
    assert plain.model.digest() == alone.model.digest()


def test_checked_plugins_end_in_the_same_bits(make: Any) -> None:
    text = (
        "regularizers: [toy_term]\nmodifiers: [toy_dropout]\nopacity: [toy_fade]\n"
        "densification: {use: toy_growth, every: 3}\n"
    )
    plain, checked = make(text), make(text)
    train(plain)
    with checked_plugins():
        train(checked)
    assert plain.model.digest() == checked.model.digest()


def test_global_random_numbers_are_checked_in_the_first_call_and_every_eleventh(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(self: ToyTerm, step: Step) -> torch.Tensor:
        if step.iteration == late:
            torch.rand(1)
        return step.rendering.alpha.mean()

    monkeypatch.setattr(ToyTerm, "loss", draw)
    text = "regularizers: [{use: toy_term, start: 3, every: 2, phase: 0}]\n"
    for late in (4, 26):
        with pytest.raises(PluginError, match="global generator") as caught:
            train(make(text, "training.iterations=26"))
        assert f"iteration {late}" in caught.value.where
    late = 6
    train(make(text))
    with checked_plugins(), pytest.raises(PluginError, match="global generator"):
        train(make(text))


@pytest.mark.parametrize("cycle", range(10))
def test_no_cycle_of_ten_iterations_hides_from_the_checks(
    make: Any, monkeypatch: pytest.MonkeyPatch, cycle: int
) -> None:
    def draw(self: ToyTerm, step: Step) -> torch.Tensor:
        drawn = torch.rand(()) if step.iteration % 10 == cycle else torch.ones(())
        return step.rendering.alpha.mean() * drawn

    monkeypatch.setattr(ToyTerm, "loss", draw)
    with pytest.raises(PluginError, match=r"global generator|same call was repeated"):
        train(make("regularizers: [toy_term]\n", "training.iterations=110"))


def test_a_call_is_repeated_on_a_copy_with_the_same_state(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counters, lists and the generator may change with each call."""

    def loss(self: Any, step: Step) -> torch.Tensor:
        self.calls = [*getattr(self, "calls", []), step.iteration]
        drawn = torch.rand((), generator=self.generator)
        return step.rendering.alpha.mean() * drawn * len(self.calls)

    monkeypatch.setattr(ToyTerm, "loss", loss)
    plain, checked = make("regularizers: [toy_term]\n"), make("regularizers: [toy_term]\n")
    train(plain)
    with checked_plugins():
        train(checked)
    assert plain.model.digest() == checked.model.digest()


def test_a_component_that_cannot_be_copied_is_called_once(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    def loss(self: Any, step: Step) -> torch.Tensor:
        self.lines = iter(line for line in "abc")
        calls.append(step.iteration)
        return step.rendering.alpha.mean()

    monkeypatch.setattr(ToyTerm, "loss", loss)
    train(make("regularizers: [toy_term]\n"))
    assert calls == sorted(set(calls))


def test_a_loss_that_overflows_stops_the_run(make: Any) -> None:
    trainer = make("")
    poison(trainer, slice(11, 14), slice(None), 1e30)
    with pytest.raises(RunError, match="the loss overflows") as caught:
        train(trainer)
    assert "iteration 1" in caught.value.where


def test_a_parameter_that_is_nan_ends_the_iteration(make: Any) -> None:
    trainer = make("", "training.iterations=9")
    iterations = trainer.run()
    next(iterations)
    poison(trainer, slice(3, 6), [3, 7], float("nan"))
    next(iterations)
    for go_on in (trainer.state, lambda: next(iterations)):
        with pytest.raises(GaussianError, match="6 values are not finite") as caught:
            go_on()
        assert caught.value.where == "log_scales[3]; iteration 3"


def test_max_gaussians_is_a_limit_and_is_logged_once(
    make: Any, caplog: pytest.LogCaptureFixture
) -> None:
    trainer = make("densification: {use: toy_growth, prune: false}\n", "training.max_gaussians=100")
    with caplog.at_level(logging.WARNING):
        counts = [done.gaussians for done in train(trainer)]
    assert max(counts) == counts[-1] == 100
    assert caplog.text.count("max_gaussians") == 1
