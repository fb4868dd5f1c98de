"""Two runs differ only in what was toggled: a component that is off leaves no trace, and none that is on
draws from another's random numbers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import torch

import stereogs
from core_rasterizer import open_device
from registry.testing import tiny_scene
from stereogs import Pipeline
from tests.host import GROUP, Offer, Part, Parts, Plugins, Trainer, installed_entries
from tests.stereogs_plugins.priors import graphs

TOY_NORMALS = EntryPoint("toy_normals", "tests.stereogs_plugins.regularizers.toy_normals", GROUP)
PLUGINS = Plugins([*installed_entries(), TOY_NORMALS])


def _takes_part(offer: Offer) -> bool:
    return offer.distribution == "stereogs-plugins" and offer.point.in_pipeline


SHIPPED = [offer for offer in PLUGINS.all() if _takes_part(offer)]
IN_THE_LOOP = [offer for offer in SHIPPED if offer.point.scheduled]
AFTER_IT = [o for o in SHIPPED if o.point.section in ("metrics", "exporters", "reports")]
CAN_BE_OFF = [offer for offer in SHIPPED if not offer.point.required]
BASE: dict[str, Any] = {
    "name": "purity",
    "initializer": {"use": "random", "count": 100},
    "training": {"iterations": 4, "sh_degree": 0},
}
SWEEP = {"priors": [{"use": "plane_sweep", "planes": 12}]}
DENSE = SWEEP | {"initializer": {"use": "consistency_dense", "hand_on_depth": True}}
TWO_FIELDS = {"training": BASE["training"] | {"fields": 2}}
NEEDS: dict[str, dict[str, Any]] = {
    "stereo_depth": {"priors": ["sgm"]},
    "depth_ranking": SWEEP,
    "patch_depth": SWEEP,
    "depth_from_initializer": DENSE,
    "forward_warping": DENSE,
    "prior_normals": {"priors": ["toy_normals"]},
    "field_agreement": TWO_FIELDS,
    "co_pruning": TWO_FIELDS,
}
"""Sections that a component cannot do without; `monocular` adds those that need a network."""
SETTINGS: dict[str, dict[str, Any]] = {
    "parameter_l1": {"parameter": "opacities"},
    "patch_depth": {"form": "hard", "smallest": 4, "largest": 8},
    "expected_opacity": {"rate": 0.2},
    "co_pruning": {"distance": 1.0},
    "video": {"frames": 2},
}
"""Settings without a default, or with one that takes long."""


@pytest.fixture(scope="module", autouse=True)
def monocular(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A monocular prior for those that ask for one."""
    model = str(graphs.mono(tmp_path_factory.mktemp("purity") / "mono.onnx"))
    prior = {"use": "onnx_mono", "model": model, "family": "dpt", "short_side": 56}
    with pytest.MonkeyPatch.context() as patch:
        for name in ("pearson_depth", "distant_l1"):
            patch.setitem(NEEDS, name, {"priors": [prior]})
        yield


def label(offer: Offer) -> str:
    return f"{offer.point.section}.{offer.name}"


def pipeline(*offers: Offer, **common: Any) -> Pipeline:
    """The base with some components of the same settings, called in each iteration."""
    values = dict(BASE)
    for offer in offers if common.get("enabled", True) else ():
        needed = NEEDS.get(offer.name, {})
        priors = list(values.get("priors", []))
        priors += [prior for prior in needed.get("priors", []) if prior not in priors]
        values |= needed | ({"priors": priors} if priors else {})
    for offer in offers:
        always = {"start": 1, "stop": None, "every": 1} if offer.point.scheduled else {}
        written = {"use": offer.name, **always, **SETTINGS.get(offer.name, {}), **common}
        values[offer.point.section] = [*values.get(offer.point.section, []), written]
    return stereogs.build_pipeline(values, plugins=PLUGINS)


def trained(chosen: Pipeline, out: Path | None = None) -> str:
    return stereogs.train(chosen, scene=tiny_scene(), out=out, progress=False).hash


def test_everything_that_ships_is_here() -> None:
    assert {"dropout", "stereo_depth", "gradient_threshold"} <= {o.name for o in IN_THE_LOOP}
    assert {"psnr", "ply", "html"} <= {o.name for o in AFTER_IT}


@pytest.mark.parametrize("offer", CAN_BE_OFF, ids=label)
def test_a_component_that_is_off_is_a_component_that_is_absent(offer: Offer) -> None:
    absent = pipeline()
    assert pipeline(offer, enabled=False).items == absent.items
    values = BASE | {offer.point.section: [{"use": offer.name, **SETTINGS.get(offer.name, {})}]}
    disabled = stereogs.build_pipeline(values, disable=[offer.name], plugins=PLUGINS)
    assert disabled.to_yaml() == absent.to_yaml()


def test_a_run_with_everything_off_ends_in_the_same_bits() -> None:
    assert trained(pipeline(*CAN_BE_OFF, enabled=False)) == trained(pipeline())


def test_what_comes_after_training_changes_no_bit(tmp_path: Path) -> None:
    assert trained(pipeline(*AFTER_IT), tmp_path / "run") == trained(pipeline())
    assert (tmp_path / "run" / "results.json").is_file()


def test_of_two_neighbours_each_begins_as_if_it_were_alone() -> None:
    device = open_device()

    def seeds(*offers: Offer) -> dict[str, int]:
        chosen = {label(offer) for offer in offers}
        return {
            part.item.qualified_name: part.component.generator.initial_seed()
            for part in Parts(pipeline(*offers), device)
            if part.item.qualified_name in chosen
        }

    alone = {label(offer): seeds(offer) for offer in IN_THE_LOOP}
    own = [seeds_of[name] for name, seeds_of in alone.items()]
    assert len(set(own)) == len(own), "no two share their numbers"
    for first, second in pairwise([*IN_THE_LOOP, IN_THE_LOOP[0]]):
        both = seeds(first, second)
        assert both == alone[label(first)] | alone[label(second)]


@pytest.mark.parametrize("offer", IN_THE_LOOP, ids=label)
def test_a_component_at_work_draws_from_nobody_elses_numbers(
    offer: Offer, monkeypatch: pytest.MonkeyPatch
) -> None:
    dropout = next(other for other in IN_THE_LOOP if other.name == "dropout")
    chosen = [dropout] if offer is dropout else [offer, dropout]
    trainers: list[Trainer] = []
    calls: list[str] = []
    made, at_work, called = Trainer.__init__, Part.at_work, Part.call

    def remember(self: Trainer, *arguments: Any, **named: Any) -> None:
        made(self, *arguments, **named)
        trainers.append(self)

    def watched(self: Part, *arguments: Any, **named: Any) -> AbstractContextManager[None]:
        return _leaving_others_alone(self, at_work(self, *arguments, **named), trainers, calls)

    monkeypatch.setattr(Trainer, "__init__", remember)

    def watched_call(self: Part, *given: Any, **named: Any) -> Any:
        with _leaving_others_alone(self, nullcontext(), trainers, calls):
            return called(self, *given, **named)

    monkeypatch.setattr(Part, "at_work", watched)
    monkeypatch.setattr(Part, "call", watched_call)
    trained(pipeline(*chosen))
    assert calls.count(label(offer)) >= 4


@contextmanager
def _leaving_others_alone(
    part: Part, block: AbstractContextManager[None], trainers: list[Trainer], calls: list[str]
) -> Iterator[None]:
    others = [] if not trainers else list(_generators(trainers[0], part))
    before = [generator.get_state() for generator in others]
    with block:
        yield
    for generator, state in zip(others, before, strict=True):
        assert torch.equal(generator.get_state(), state)
    calls.append(part.item.qualified_name)


def _generators(trainer: Trainer, part: Part) -> Iterator[torch.Generator]:
    """All but one component's: the host's own, too."""
    yield trainer._views._generator
    yield trainer.fields[0]._topology
    yield from (other.component.generator for other in trainer.parts if other is not part)
