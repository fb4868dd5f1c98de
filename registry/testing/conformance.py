"""One component class, tried."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from torch import Tensor

from core_rasterizer import Device, open_device

from ..contract.component import Component, Context, Settings
from ..contract.prior import Prior
from ..pipeline.parts import TRAINING_SECTIONS
from ..pipeline.settings_check import escape_variables, validate_settings
from ..pipeline.yaml_source import Node, parse, to_yaml
from ..plugins.discovery import GROUP, Plugins, check_offer
from ..training.component_parameters import check_groups
from .bench import Bench, Refusal
from .companions import UNDER_TEST, point_of
from .judging import require, same
from .listening import listen
from .questions import ASK
from .rehearsal import rehearse
from .scenes import EMPTY, PIXEL, REAL, Size


@dataclass(frozen=True)
class Cost:
    """What the component's own code took on images of 320 x 240 and 5,000 Gaussians.

    Args:
        seconds: for one question, after those on a small scene.
        megabytes: of 10^6 bytes, the most that the process grew by; None where nobody counts it, and
            0 where memory of earlier questions sufficed.
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
    **settings: Any,
) -> Cost:
    """Try one component class; a fault raises with a message that says which.

    Its settings are written and read back. It is asked what the host would ask on a small scene, on
    images of 320 x 240 with 5,000 Gaussians, on a scene with nothing in view and on images of one pixel
    with one Gaussian; on the last two it may refuse with an error that explains itself
    (`registry.PluginError`, `registry.SceneError`), and so it may where renders have half the photographs'
    size, as samplers may ask. What works in the training loop is trained with,
    stopped and resumed after each iteration, while Gaussians come and go. An observer hears a run that is
    stopped and resumed, and one that fails.

    Args:
        priors: what `Step.priors` and `initialize` are given; where the component is trained with,
            they are built anew from their settings.
        device: where the Gaussians live; None chooses.
        settings: for the component, as Python values.

    Returns:
        What its answers cost.

    Raises:
        AssertionError: the component breaks the contract.
        ExplainedError: the host or the engine would refuse the class or an answer.
    """
    point = point_of(component)
    check_offer(point, UNDER_TEST, component)
    _check_entry_points(component)
    chosen = component.Settings(**settings)
    _check_settings(chosen)
    given = priors or {}
    bench = Bench(device or open_device(), given)
    first, again = (_answer(component, chosen, bench) for _ in range(2))
    require(
        same(first, again), f"two {point.title}s with one seed gave different answers to a question"
    )
    cost = _at_size(component, chosen, bench, REAL)
    for size in (EMPTY, PIXEL):
        with suppress(Refusal):
            _at_size(component, chosen, bench, size)
    if point.section in TRAINING_SECTIONS:
        with suppress(Refusal):
            _at_size(component, chosen, bench, bench.size, shrink=2)
        rehearse(component, chosen, bench)
    if point.observes:
        listen(component, chosen, bench)
    return cost


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


def _answer(component: type[Component[Any]], settings: Settings, bench: Bench) -> Any:
    """What a new component answers to the question of its kind, and that its state can be had."""
    built = _built(component, settings, bench)
    try:
        answer = ASK[point_of(component).section](bench, built)
    except Refusal as refusal:
        raise refusal.error from refusal.error.__cause__
    check_groups(built.parameters())
    state = built.state()
    for name, value in state.items():
        require(isinstance(value, Tensor), f"state()[{name!r}] is not a tensor")
    other = _built(component, settings, bench)
    other.restore({name: value.clone() for name, value in state.items()})
    require(same(other.state(), state), "restore() does not bring back what state() returned")
    return answer


def _at_size(
    component: type[Component[Any]], settings: Settings, small: Bench, size: Size, shrink: int = 1
) -> Cost:
    """What an answer at another size costs."""
    bench = Bench(small.device, small.priors, size, shrink)
    built = _built(component, settings, bench)
    ASK[point_of(component).section](bench, built)
    return Cost(bench.seconds, bench.megabytes)


def _built(component: type[Component[Any]], settings: Settings, bench: Bench) -> Component[Any]:
    """A new component that has seen the scene."""
    built = component(settings, Context(UNDER_TEST, 7, bench.device))
    if point_of(component).section in TRAINING_SECTIONS:
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
    tree = parse(to_yaml(escape_variables({"settings": plain})), "settings").content
    written = tree["settings"] if isinstance(tree, dict) else Node({}, parse("", "").place)
    from_yaml = validate_settings(type(settings), written, "settings")
    require(from_yaml == settings, "the settings do not survive being written to a pipeline file")
