"""Each extension point of the training loop, used by a small plugin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from core_rasterizer import Device, ExplainedError
from registry import PluginError, Step
from registry.testing import tiny_scene
from registry.training.assembly import assemble, restore
from registry.training.checkpoint import Checkpoint
from registry.training.field import Field
from registry.training.trainer import Iteration, Trainer
from tests.host import PARAMETERS, Parts, Plugins, parse_pipeline
from tests.registry.toy_extension_points import ToyTwin

BASE = "name: t\nscene: toy_scene\ninitializer: toy_guided\n"
Make = Callable[..., Trainer]


@pytest.fixture
def make(extension_points: Plugins, device: Device) -> Make:
    def make(text: str, *overrides: str) -> Trainer:
        settings = ["training.iterations=6", "training.sh_degree=1", *overrides]
        pipeline = parse_pipeline(
            BASE + text, extension_points, source="p.yaml", overrides=settings
        )
        parts, scene = Parts(pipeline, device), tiny_scene()
        points = parts.one("initializer").component.initialize(scene.for_training(), {})
        return assemble(parts, scene, points)

    return make


def train(trainer: Trainer) -> list[Iteration]:
    return list(trainer.run())


def resumed(make: Make, text: str, *overrides: str, stop: int = 3) -> tuple[Trainer, Trainer]:
    """Return a trainer that ran without a stop, and one that was restored from its state halfway."""
    whole, first, second = (make(text, *overrides) for _ in range(3))
    train(whole)
    for done in first.run():
        if done.number == stop:
            break
    held = Checkpoint(first.iteration, 0.0, first.state(), "")
    for name, values in held.part("model").items():
        assert values.shape[0] == first.model.count, name
    second = restore(second.parts.for_field(0), second.scene, held)
    train(second)
    return whole, second


# What an iteration learns from.


def test_a_sampler_changes_target_view_and_background(make: Make) -> None:
    dark = train(make("samplers: [{use: toy_target, brightness: 0}]\n", "training.iterations=60"))
    assert dark[-1].logged["photometric"] < dark[0].logged["photometric"]
    plain, same = (
        make(""),
        make("samplers: [{use: toy_target, brightness: 1, background: [0, 0, 0]}]"),
    )
    train(plain)
    train(same)
    assert plain.model.digest() == same.model.digest()
    one_view = make("samplers: [{use: toy_target, brightness: 1, first_view: true}]\n")
    train(one_view)
    assert one_view.model.digest() != plain.model.digest()


def test_a_band_that_fades_in_is_trained(make: Make) -> None:
    trainer = make("samplers: [{use: toy_target, sh_degree: 0.5}]\n", "training.iterations=1")
    train(trainer)
    assert trainer.model.read("sh")[:, 1:4].any()


def test_a_target_of_another_size_is_refused(make: Make) -> None:
    with pytest.raises(PluginError, match="the target is") as caught:
        train(make("samplers: [{use: toy_target, wrong: true}]\n"))
    assert "toy_target" in caught.value.where


def test_a_target_that_is_too_bright_is_refused(make: Make) -> None:
    with pytest.raises(PluginError, match="outside") as caught:
        train(make("samplers: [{use: toy_target, brightness: 50}]\n"))
    assert "toy_target" in caught.value.where


# Colours between render and loss; parameters of a plugin.


def test_an_appearance_is_trained_with_the_gaussians(make: Make) -> None:
    text = "samplers: [{use: toy_target, brightness: 0.2}]\nappearances: [toy_exposure]\n"
    done = train(make(text, "training.iterations=30"))
    assert done[0].logged["exposure"] == 1
    assert done[-1].logged["exposure"] < 0.9


def test_a_plugins_parameters_are_saved_with_their_moments(make: Make) -> None:
    whole, second = resumed(make, "appearances: [toy_exposure]\n")
    exposures = [t.parts["appearances"][0].component.factor for t in (whole, second)]
    assert exposures[0] != 1
    assert torch.equal(*exposures)
    assert whole.model.digest() == second.model.digest()


# Refined cameras.


def test_a_sampler_refines_the_camera_by_its_gradient(make: Make) -> None:
    names = ("position", "position_final", "sh_constant", "sh_rest", "opacity", "scale", "rotation")
    still = [f"training.learning_rates.{name}=0" for name in names]
    trainer = make("samplers: [toy_pose]\n", "training.iterations=60", *still)
    done = train(trainer)
    assert done[0].logged["offset"] == pytest.approx(0.05)
    assert done[-1].logged["offset"] < 0.01


# Losses on parameters, terms stepped alone, parameters left alone.


def test_a_loss_on_parameters_changes_only_those(make: Make) -> None:
    text = "regularizers: [{use: toy_shape, weight: 1000, step: alone}]\n"
    quiet = [f"training.learning_rates.{name}=0" for name in ("position", "position_final")]
    trainer = make(text, "training.iterations=1", *quiet)
    before = trainer.model.gaussians()
    train(trainer)
    after = trainer.model.gaussians()
    assert (after.log_scales < before.log_scales).all()
    assert torch.equal(after.means, before.means)


def test_a_term_stepped_alone_has_its_own_step(make: Make) -> None:
    together = make("regularizers: [toy_shape]\n")
    alone = make("regularizers: [{use: toy_shape, step: alone}]\n")
    for trainer in (together, alone):
        train(trainer)
    optimizers: list[Any] = [trainer.fields[0].optimizer for trainer in (together, alone)]
    steps = [optimizer.steps for optimizer in optimizers]
    assert steps == [6, 12]


def test_a_term_stepped_alone_does_not_change_other_groups_and_moments(make: Make) -> None:
    text = "regularizers: [{use: toy_picture, step: alone, opacity: 0.9, moves: [means]}]\n"
    rates = ("position", "sh_constant", "sh_rest", "opacity", "scale", "rotation")
    still = [f"training.learning_rates.{name}=0" for name in rates[1:]]
    trainer = make(text, "training.iterations=1", *still)
    moments = trainer.fields[0].optimizer.state()["first_moments"].clone()
    before = trainer.model.gaussians()
    trainer.fields[0].begin(1, trainer.scene.for_training().train[0])
    trainer.fields[0].step_terms_alone()
    after, changed = (
        trainer.model.gaussians(),
        trainer.fields[0].optimizer.state()["first_moments"] != moments,
    )
    assert not torch.equal(after.means, before.means)
    assert changed[:3].any()
    assert not changed[3:].any()
    for name in PARAMETERS[1:]:
        assert torch.equal(getattr(after, name), getattr(before, name))


def test_a_render_may_leave_parameters_alone(make: Make) -> None:
    def gradients(detach: str) -> dict[str, torch.Tensor]:
        text = f"regularizers: [{{use: toy_picture, step: alone, detach: {detach}}}]\n"
        trainer = make(text, "training.iterations=1")
        trainer.fields[0].begin(1, trainer.scene.for_training().train[0])
        trainer.fields[0].step_terms_alone()
        return {name: trainer.model.gradient(name).clone() for name in PARAMETERS}

    free, held = gradients("[]"), gradients("[means, sh]")
    for name in PARAMETERS:
        assert free[name].any()
        assert held[name].any() == (name not in ("means", "sh"))
    assert torch.equal(free["log_scales"], held["log_scales"])


def test_plugins_can_read_the_visibility(make: Make) -> None:
    (done,) = train(make("regularizers: [toy_picture]\n", "training.iterations=1"))
    assert 0 < done.logged["seen"] <= 60


def test_unknown_groups_are_refused_by_name(make: Make) -> None:
    with pytest.raises(PluginError, match="colour") as caught:
        train(make("regularizers: [{use: toy_shape, step: alone, moves: [colour]}]\n"))
    assert "toy_shape" in caught.value.where


# Policies.


def test_policies_run_in_the_order_of_the_pipeline(make: Make) -> None:
    text = """\
densification:
  - {use: toy_move, name: a, add: 2, stop: 1}
  - {use: toy_move, name: b, children: 4, start: 2, stop: 2}
opacity: [{use: toy_fade, value: 0.5}, {use: toy_fade, name: again, factor: 0.5}]
"""
    trainer = make(text, "training.learning_rates.opacity=0")
    done = train(trainer)
    assert [d.gaussians for d in done] == [62, 65, 65, 65, 65, 65]
    assert trainer.model.opacities().allclose(torch.tensor(0.25))


def test_one_policy_that_resets_is_enough(make: Make) -> None:
    text = "opacity: [{use: toy_fade, reset: true}, {use: toy_fade, name: again, factor: 1}]\n"
    trainer = make(text, "training.iterations=1")
    train(trainer)
    assert not trainer.fields[0].optimizer.state()["second_moments"][10].any()


def test_statistics_are_restored(make: Make) -> None:
    text = "densification: {use: toy_move, every: 5}\n"
    whole, second = resumed(make, text, "training.iterations=4")
    sums = whole.model.statistics.sums()
    assert sums.any()
    assert torch.equal(sums, second.model.statistics.sums())


def test_states_follow_edits_that_add_split_and_relocate(make: Make) -> None:
    text = "densification: {use: toy_move, children: 3, add: 2, relocate: 2, start: 5, stop: 5}\n"
    trainer = make(text)
    train(trainer)
    assert trainer.model.count == 60 + 2 + 2
    parent = trainer.parts["densification"][0].component.parent
    assert parent.tolist() == [1, 1, 1, *range(4, 60), 0, 0, 0, 1, 2]


def test_the_limit_counts_all_children_and_added_ones(make: Make) -> None:
    text = "densification: {use: toy_move, children: 5, add: 3, start: 5}\n"
    trainer = make(text, "training.max_gaussians=62")
    train(trainer)
    assert trainer.model.count <= 62


def test_absolute_gradients_are_collected_on_request_and_restored(make: Make) -> None:
    text = "densification: {use: toy_move, absolute: true, every: 5}\n"
    whole, second = resumed(make, text)
    assert whole.model.digest() == second.model.digest()
    assert torch.equal(whole.model.statistics.sums(), second.model.statistics.sums())
    (done,) = [d for d in train(make(text)) if "absolute" in d.logged]
    assert done.logged["absolute"] > 0
    plain = make("densification: {use: toy_move, every: 5}\n")
    train(plain)
    assert len(plain.model.statistics.sums()) == 2


def test_a_phase_shifts_the_schedule(make: Make) -> None:
    text = "regularizers: [{use: toy_shape, start: 2, every: 3, phase: 2}]\n"
    done = train(make(text, "training.iterations=9"))
    assert [d.number for d in done if "regularizers.toy_shape" in d.logged] == [2, 5, 8]


def test_a_perturbation_comes_after_the_step(make: Make) -> None:
    plain, noisy = make(""), make("perturbations: [{use: toy_noise, start: 6}]\n")
    train(plain)
    train(noisy)
    for name in PARAMETERS[1:]:
        assert torch.equal(plain.model.read(name), noisy.model.read(name))
    assert not torch.equal(plain.model.read("means"), noisy.model.read("means"))
    with pytest.raises(PluginError, match="offset of 'means'") as caught:
        train(make("perturbations: [{use: toy_noise, wrong: true}]\n"))
    assert "toy_noise" in caught.value.where


def test_kinds_of_points_follow_each_edit(make: Make) -> None:
    text = "densification: {use: toy_move, children: 3, every: 2}\nperturbations: [toy_noise]\n"
    trainer = make(text, "training.iterations=7")
    counts = [done.logged["even"] for done in train(trainer)]
    assert counts == [30, 32, 32, 32, 32, 34, 34]  # what was second is first then
    assert int(trainer.fields[0].kinds["even"].sum()) == 34


def test_a_perturbation_that_makes_a_parameter_infinite_is_named(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def offsets(self: object, step: Step) -> dict[str, torch.Tensor]:
        return {"means": torch.full_like(step.model.read("means"), 2e38)}

    monkeypatch.setattr("tests.registry.toy_extension_points.ToyNoise.offsets", offsets)
    with pytest.raises(ExplainedError, match="not finite") as caught:
        train(make("perturbations: [toy_noise]\n"))
    assert "means[0]; in perturbation 'toy_noise'" in caught.value.where
    assert "iteration 2" in caught.value.where


# Several fields.

TWINS = """\
regularizers: [{use: toy_twin, start: 2}]
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 2}
"""


def test_fields_in_lock_step_differ_and_see_each_other(make: Make) -> None:
    trainer = make(TWINS, "training.fields=3")
    done = train(trainer)
    assert len({field.model.digest() for field in trainer.fields}) == 3
    assert done[-1].logged["others"] == 2
    assert done[-1].logged["field2/others"] == 2
    assert done[-1].gaussians == trainer.fields[0].model.count


@pytest.mark.parametrize(
    "text",
    ["modifiers: [toy_dropout]\n", "densification: {use: toy_move, children: 3, stop: 1}\n"],
    ids=["components", "children of splits"],
)
def test_each_source_of_random_numbers_separates_fields_alone(make: Make, text: str) -> None:
    trainer = make(text, "training.fields=2")
    train(trainer)
    first, second = (field.model.digest() for field in trainer.fields)
    assert first != second


def test_each_stage_runs_for_all_fields_before_the_next(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stages = (
        *("begin", "step_terms_alone", "render", "differentiate"),
        *("update_opacities", "change_topology", "step_optimizer", "perturb"),
    )
    called: list[tuple[str, int]] = []

    def noting(name: str) -> Callable[..., Any]:
        stage = getattr(Field, name)

        def run(field: Field, *given: Any) -> Any:
            called.append((name, field.index))
            return stage(field, *given)

        return run

    for name in stages:
        monkeypatch.setattr(Field, name, noting(name))
    train(make("", "training.fields=2", "training.iterations=1"))
    assert called == [(name, index) for name in stages for index in (0, 1)]


def test_other_fields_do_not_change_the_first(make: Make) -> None:
    alone, first = (
        make("modifiers: [toy_dropout]\n"),
        make("modifiers: [toy_dropout]\n", "training.fields=2"),
    )
    train(alone)
    train(first)
    assert alone.model.digest() == first.model.digest()


def test_several_fields_are_resumed_to_the_same_bits(make: Make) -> None:
    whole, second = resumed(make, TWINS, "training.fields=2")
    digests = [[field.model.digest() for field in t.fields] for t in (whole, second)]
    assert digests[0] == digests[1]


def test_bands_of_the_initial_points_train_from_the_start_and_after_a_resumption(
    extension_points: Plugins, device: Device
) -> None:
    overrides = ["training.iterations=6", "training.sh_degree=2"]
    pipeline = parse_pipeline(BASE, extension_points, source="p.yaml", overrides=overrides)
    scene = tiny_scene()
    assert scene.points is not None
    bands = torch.rand(len(scene.points), 4, 3)
    points = replace(scene.points, sh=bands)

    def make(text: str) -> Trainer:
        return assemble(Parts(pipeline, device), scene, points)

    whole, second = resumed(make, "")
    assert whole.model.digest() == second.model.digest()
    sh = whole.model.gaussians().sh
    assert not torch.equal(sh[:, 1:4], bands[:, 1:])
    assert not sh[:, 4:].any()


def test_components_of_every_field_begin_once_when_resumed(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[ToyTwin] = []
    monkeypatch.setattr(ToyTwin, "begin_training", lambda self, scene: begun.append(self))
    _, second = resumed(make, TWINS, "training.fields=2")
    assert len(begun) == len(set(begun)) == 8
    assert [one.parts.one("regularizers").component for one in second.fields] == begun[-2:]


# What the initializer knows, and what nobody may know.


def test_depth_of_the_initializer_reaches_regularizers_and_is_restored(make: Make) -> None:
    whole, second = resumed(make, "regularizers: [toy_guide]\n")
    assert whole.model.digest() == second.model.digest()


@pytest.mark.parametrize(
    ("at", "message"),
    [("test", "test views"), ("depth", "true depth"), ("early", "before it exists")],
)
def test_reading_true_depth_is_an_error_that_names_the_plugin(
    make: Make, at: str, message: str
) -> None:
    with pytest.raises(ExplainedError, match=message) as caught:
        train(make(f"modifiers: [{{use: toy_peek, at: {at}}}]\n"))
    assert "toy_peek" in caught.value.where
    assert "iteration 1" in caught.value.where


def test_an_initializer_sees_no_test_view(make: Make) -> None:
    with pytest.raises(PluginError, match="test views"):
        make("", "initializer.peek=true")


# The loss.


def test_l1_and_dissimilarity_have_separate_weights(make: Make) -> None:
    def first(*overrides: str) -> float:
        return train(make("", "training.iterations=1", *overrides))[0].loss

    l1 = first("training.ssim_weight=0")
    both = first("training.ssim_weight=0.2", "training.l1_weight=1")
    usual = first("training.ssim_weight=0.2")
    assert both == pytest.approx(usual + 0.2 * l1, rel=1e-5)


def test_unused_extension_points_change_no_bit(make: Make) -> None:
    plain, dressed = (
        make(""),
        make("opacity: []\nsamplers: []\nperturbations: []\n", "training.fields=1"),
    )
    assert [d.loss for d in train(plain)] == [d.loss for d in train(dressed)]
    assert plain.model.digest() == dressed.model.digest()
