"""Components declare what the host renders or collects for them; nothing else is made or allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import registry as r
from core_rasterizer import Device, Edit
from registry.testing import check, tiny_scene
from registry.training.assembly import assemble
from registry.training.step import OUTPUTS
from registry.training.trainer import Trainer
from tests.host import (
    HostSettings,
    Item,
    Parts,
    Pipeline,
    TrainingSettings,
    faults,
    pipeline_item,
    pipeline_of,
    refuse_unmet_needs,
)
from tests.registry.toy_extension_points import ToyTwin


class Asking(r.Settings):
    declare: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()


def used(step: r.Step, name: str) -> Tensor:
    """Return the sum of an output."""
    if name == "other_fields":
        return torch.tensor(float(len(step.others)))
    if name in OUTPUTS:
        rendered: Tensor = getattr(step, name)
        return rendered.sum() / 1000
    collected: Tensor = getattr(step.model, name)()
    return collected.sum()


class Term(r.Regularizer[Asking]):
    """A loss on the outputs in `uses`."""

    @classmethod
    def needs_rendered(cls, settings: Asking) -> tuple[Any, ...]:
        return settings.declare

    def loss(self, step: r.Step) -> Tensor:
        total = step.rendering.rgb.mean()
        for name in self.settings.uses:
            step.log(name, float(used(step, name).detach()))
            total = total + used(step, name)
        return total


class Policy(r.Densification[Asking]):
    """Reads outputs, and clones the first Gaussian."""

    needs_rendered = Term.needs_rendered

    def refine(self, step: r.Step) -> Edit:
        for name in self.settings.uses:
            step.log(f"{self.context.name}_{name}", float(used(step, name).detach()))
            if name == "contributions":
                assert len(step.contributions) == step.model.count
        return Edit(clone=torch.arange(step.model.count) == 0)


class Early(r.Sampler[Asking]):
    needs_rendered = Term.needs_rendered

    def sample(self, step: r.Step, sample: r.Sample) -> r.Sample:
        return sample


def item(
    kind: type[r.Component[Any]], name: str, declare: str = "", use: str | None = None, **host: Any
) -> Item:
    wanted = declare if use is None else use
    settings = Asking(declare=tuple(declare.split()), uses=tuple(wanted.split()))
    made = pipeline_item(kind, settings, name)
    return replace(made, host=HostSettings(use=name, **host))


def pipeline(*items: Item, **training: Any) -> Pipeline:
    return pipeline_of([*items], TrainingSettings(iterations=6, sh_degree=0, **training))


def trained(
    device: Device, *items: Item, **training: Any
) -> tuple[Trainer, list[dict[str, float]]]:
    """Return the trainer after the last iteration, and the logs."""
    parts, scene = Parts(pipeline(*items, **training), device), tiny_scene()
    assert scene.points is not None
    trainer = assemble(parts, scene, scene.points)
    return trainer, [dict(done.logged) for done in trainer.run()]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Record which output is made in which iteration."""
    record: list[tuple[str, int]] = []

    def recorded(name: str, make: Callable[[r.Step], Tensor]) -> Callable[[r.Step], Tensor]:
        def call(step: r.Step) -> Tensor:
            record.append((name, step.iteration))
            return make(step)

        return call

    for name, make in list(OUTPUTS.items()):
        monkeypatch.setitem(OUTPUTS, name, recorded(name, make))
    return record


def test_an_output_is_made_once_for_all_that_are_due(
    device: Device, made: list[tuple[str, int]]
) -> None:
    first = item(Term, "first", "normals", every=2)
    second = item(Term, "second", "normals contributions", every=3)
    trained(device, first, second, item(Term, "plain"))
    assert made == [
        ("normals", 2), ("contributions", 3), ("normals", 3), ("normals", 4), ("contributions", 6),
        ("normals", 6),
    ]  # fmt: skip


def test_terms_with_a_step_of_their_own_get_new_outputs(
    device: Device, made: list[tuple[str, int]]
) -> None:
    alone = item(Term, "alone", "normals", every=6, step="alone")
    trained(device, alone, item(Term, "too", "normals", every=6))
    assert made == [("normals", 6)] * 2


@pytest.mark.parametrize(
    "name",
    ["normals", "contributions", "screen_gradient", "absolute_screen_gradient", "other_fields"],
)
def test_what_is_not_declared_is_refused(device: Device, name: str) -> None:
    """Even if it exists, because another component declares it."""
    other = item(Term, "other", name, use="", every=1)
    with pytest.raises(r.PluginError, match=f"uses '{name}', which it does not declare") as caught:
        trained(device, other, item(Term, "greedy", use=name, start=3), fields=2)
    assert "greedy" in caught.value.where
    assert "iteration 3" in caught.value.where
    assert "needs_rendered" in caught.value.fix
    with pytest.raises(r.PluginError, match=f"uses '{name}', which it does not declare"):
        check(Term, uses=(name,))


def test_statistics_are_collected_for_whoever_declares_them(device: Device) -> None:
    growth = item(Policy, "growth", every=4)
    nobody, _ = trained(device, growth)
    assert not nobody.model.statistics.sums().any()
    limited, _ = trained(device, growth, max_gaussians=1000)
    assert limited.model.statistics.sums().any()
    reader = item(Policy, "reader", "absolute_screen_gradient", start=5, stop=5)
    _, logs = trained(device, reader)
    assert logs[4]["reader_absolute_screen_gradient"] > 0


def test_contributions_are_the_shares_of_the_light_and_follow_edits(device: Device) -> None:
    first, second = (item(Policy, name, "contributions") for name in ("first", "second"))
    trainer, logs = trained(device, first, second)
    camera = tiny_scene().train[0].camera
    assert logs[0]["second_contributions"] > logs[0]["first_contributions"] > 0
    step = trainer.fields[0]._step
    with torch.no_grad():
        light = step.render(step.sample.camera).alpha.sum()
    fresh = OUTPUTS["contributions"](step)
    assert float(fresh.sum()) == pytest.approx(float(light), rel=1e-4)
    assert float(fresh.sum()) < camera.width * camera.height


def test_normals_conform() -> None:
    check(Term, declare=("normals", "contributions"), uses=("normals",))
    check(ToyTwin)


REFUSED = [
    (
        item(Term, "a", "other_fields"),
        {},
        "'other_fields', but training has a single field",
        "fields",
    ),
    (
        item(Term, "a", "normal"),
        {},
        "'normal', which does not exist; did you mean 'normals'",
        "use",
    ),
    (item(Early, "a", "normals"), {}, "a sampler is called before the render", "regularizer"),
    (
        item(Term, "a", "other_fields", step="alone"),
        {"fields": 2},
        "rendered after the regularizers",
        "step: alone",
    ),
]


@pytest.mark.parametrize(("wrong", "training", "what", "fix"), REFUSED)
def test_needs_that_cannot_be_met_are_refused(
    wrong: Item, training: dict[str, Any], what: str, fix: str
) -> None:
    with pytest.raises(r.PluginError, match=what) as caught:
        refuse_unmet_needs(pipeline(wrong, **training))
    assert str(wrong.place) in caught.value.where
    assert fix in caught.value.fix
    refuse_unmet_needs(pipeline(replace(wrong, host=HostSettings(use="a", start=7)), **training))


def test_statistics_that_an_earlier_policy_resets_are_refused() -> None:
    edits = item(Policy, "edits", every=2)
    reader = item(Policy, "reader", "screen_gradient", every=4)
    with pytest.raises(
        r.PluginError, match="its iterations, first 4, the edit of 'edits'"
    ) as caught:
        refuse_unmet_needs(pipeline(edits, reader))
    assert "list it first" in caught.value.fix
    refuse_unmet_needs(pipeline(reader, edits))


@pytest.mark.parametrize(("every", "met"), [(3, 6), (1, 1)])
def test_a_policy_is_left_out_where_an_earlier_one_reset_its_statistics(
    device: Device, every: int, met: int
) -> None:
    """Shares of a short run meet; the policy acts in the other iterations, and a line says so."""
    edits = item(Policy, "edits", every=2 if every > 1 else 1)
    reader = item(Policy, "reader", "screen_gradient", every=every)
    (line,) = faults(pipeline(edits, reader))
    assert f"first {met}, in which the edit of 'edits' resets" in line
    assert not faults(pipeline(reader, edits))
    _, logs = trained(device, edits, reader)
    due = [k for k, log in enumerate(logs, start=1) if "reader_screen_gradient" in log]
    assert due == [k for k in range(1, len(logs) + 1) if k % every == 0 and k % 2 and every > 1]


def test_an_engine_without_absolute_gradients_is_refused() -> None:
    reader = item(Policy, "reader", "absolute_screen_gradient")
    with pytest.raises(r.PluginError, match="the engine of this run does not collect"):
        refuse_unmet_needs(pipeline(reader), absolute_gradients=False)
    check(Policy, declare=("absolute_screen_gradient",), uses=("absolute_screen_gradient",))


def test_the_conformance_suite_refuses_a_wrong_declaration() -> None:
    with pytest.raises(r.PluginError, match="does not exist"):
        check(Term, declare=("depths",))
