"""Check one component class."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from core_rasterizer import Device, open_device

from ..calls.repeats import digests, first_difference
from ..contract.checks.answers import check_state
from ..contract.component import Component, Context, Settings
from ..contract.prior import Prior
from ..contract.scene import Scene
from ..discovery import GROUP, Plugins, check_offer
from ..pipeline.faults import rendered_faults
from ..pipeline.parts import TRAINING_SECTIONS
from ..pipeline.settings_check import escape_variables, validate_settings
from ..pipeline.training_settings import TrainingSettings
from ..pipeline.yaml_source import parse, to_yaml
from ..training.gradients import check_groups
from .assertions import require
from .bench import Bench, Refused
from .component_calls import call_as_host
from .processes import in_other_processes
from .scenes import (
    EMPTY,
    PIXEL,
    REAL,
    SMALL,
    UNDER_TEST,
    hook_point,
    pipeline_item,
    pipeline_of,
)
from .training_runs import observe_and_resume, train_and_resume


@dataclass(frozen=True)
class Cost:
    """Cost of a component's own code on images of 320 x 240 and 5,000 Gaussians.

    Args:
        seconds: of one call, after calls on a small scene.
        megabytes: of 10^6 bytes, the largest growth of the process; None where it cannot be measured, 0
            where the memory of earlier calls sufficed.
    """

    seconds: float
    megabytes: float | None

    def __str__(self) -> str:
        grown = "" if self.megabytes is None else f", {self.megabytes:.0f} MB"
        return f"{self.seconds:.3f} s{grown} for {REAL.title}"


def check(
    component: type[Component[Any]],
    *,
    priors: dict[str, Prior[Any]] | None = None,
    device: Device | None = None,
    call: Callable[[Any, Scene], Any] | None = None,
    **settings: Any,
) -> Cost:
    """Check that a component class follows the contract.

    - Its settings are written and read back.
    - It is called as the host would call it, on a small scene, on images of 320 x 240 with 5,000 Gaussians,
      on a scene with nothing in view, and on images of one pixel with one Gaussian. On the last two, and
      where renders have half the photographs' size as samplers may ask, it may refuse with an error that
      explains itself (`registry.PluginError`, `registry.SceneError`).
    - If it takes part in training, a run with it is stopped and resumed after each iteration while
      Gaussians are added and removed.
    - An observer observes a run that is stopped and resumed, and one that fails.

    Args:
        priors: prior models for `Step.priors` and `initialize`; training runs build them from their settings.
        device: where the Gaussians live; None chooses.
        call: takes a prior and a scene and returns an answer, for capabilities that `registry.priors` does
            not have; a function of a module, unlike a lambda, is repeated in other processes too.
        settings: for the component, as Python values.

    Returns:
        The cost of its answers.

    Raises:
        AssertionError: the component breaks the contract.
        ExplainedError: the host or the engine would refuse the class, an answer or a side effect.
    """
    point = hook_point(component)
    check_offer(point, UNDER_TEST, component)
    _check_entry_points(component)
    chosen = component.Settings(**settings)
    _check_settings(chosen)
    alone = pipeline_of([pipeline_item(component, chosen, UNDER_TEST)], TrainingSettings(fields=2))
    for _, fault in rendered_faults(alone):
        raise fault
    bench = Bench(device or open_device(), priors or {}, ask=call)
    answers = [_answer(component, chosen, bench) for _ in range(2)]
    require(
        first_difference(*answers) is None,
        f"two {point.title}s with one seed gave different answers to the same call",
    )
    kinds = {name: (type(prior), prior.settings) for name, prior in bench.priors.items()}
    elsewhere = in_other_processes(_digests_of_answer, component, chosen, kinds, call)
    require(
        all(digest == elsewhere[0] for digest in elsewhere),
        "two processes gave different answers to the same call; does it iterate over a set, or use "
        "hash(), id(), the process's number or its start? (sort the set)",
    )
    real = Bench(bench.device, bench.priors, REAL, ask=call)
    trains = point.section in TRAINING_SECTIONS
    _call(component, chosen, real)
    for size, shrink in ((EMPTY, 1), (PIXEL, 1), *([(SMALL, 2)] if trains else [])):
        with suppress(Refused):
            _call(component, chosen, Bench(bench.device, bench.priors, size, shrink, call))
    if trains:
        train_and_resume(component, chosen, bench)
    if point.observes:
        observe_and_resume(component, chosen, bench)
    return Cost(real.seconds, real.megabytes)


def _check_entry_points(component: type[Component[Any]]) -> None:
    """Load the installed entry points of the component's module: their names must be registered.

    Raises:
        PluginError: one cannot be loaded, or its name and the registered name differ.
    """
    module = f"{component.__module__}."
    plugins = Plugins(e for e in entry_points(group=GROUP) if module.startswith(f"{e.module}."))
    plugins.all()
    for error in plugins.broken.values():
        raise error


def _digests_of_answer(
    component: type[Component[Any]],
    settings: Settings,
    kinds: Mapping[str, tuple[type[Prior[Any]], Settings]],
    call: Callable[[Any, Scene], Any] | None,
) -> dict[str, str]:
    """Return digests of the answer with new priors, for `in_other_processes`."""
    device = open_device()
    priors = {name: kind(own, Context(name, 0, device)) for name, (kind, own) in kinds.items()}
    return digests(_answer(component, settings, Bench(device, priors, ask=call)))


def _answer(component: type[Component[Any]], settings: Settings, bench: Bench) -> Any:
    """Call a new component, check its parameters and state, and return its answer."""
    built, answer = _call(component, settings, bench)
    check_groups(built.parameters())
    state = check_state(built.state())
    other = _built(component, settings, bench)
    other.restore({name: value.clone() for name, value in state.items()})
    require(
        first_difference(other.state(), state) is None,
        "restore() does not bring back what state() returned",
    )
    return answer


def _call(
    component: type[Component[Any]], settings: Settings, bench: Bench
) -> tuple[Component[Any], Any]:
    """Build a component and call it; return both it and its answer."""
    built = _built(component, settings, bench)
    return built, call_as_host(bench, built)


def _built(component: type[Component[Any]], settings: Settings, bench: Bench) -> Component[Any]:
    built = component(settings, Context(UNDER_TEST, 7, bench.device))
    if hook_point(component).section in TRAINING_SECTIONS:
        built.begin_training(bench.scene.for_training())
    return built


def _check_settings(settings: Settings) -> None:
    """Write settings as JSON and as a pipeline file, and read them back.

    Raises:
        AssertionError: the settings differ afterwards.
        PipelineError: the file is refused.
    """
    plain = settings.model_dump(mode="json")
    from_json = type(settings).model_validate_json(json.dumps(plain), strict=True)
    require(from_json == settings, "the settings do not survive being written as JSON")
    written = parse(to_yaml(escape_variables(plain)), "settings")
    from_yaml = validate_settings(type(settings), written, "settings")
    require(from_yaml == settings, "the settings do not survive being written to a pipeline file")
