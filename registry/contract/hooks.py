"""Every hook on one screen. A plugin module implements those that it has something for.

Each hook receives `register(name, component_class)` and calls it once for each component that the
plugin offers. A name is what users write after `use:` in a pipeline; it is unique within its hook
point. Nothing else is dispatched through hooks: the host builds the components that a pipeline names
and calls their methods directly.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

import pluggy

from ..runners import Runner
from . import components as c
from .command import Command, TrainOption
from .prior import Prior

PROJECT = "stereogs"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)

Registered = TypeVar("Registered", contravariant=True)


class Register(Protocol[Registered]):
    """What a hook is given: call it once for each component."""

    def __call__(self, name: str, offered: type[Registered], /) -> None: ...


@hookspec
def stereogs_register_scenes(register: Register[c.SceneLoader[Any]]) -> None:
    """Offer scene loaders: photographs and cameras in, a `Scene` out."""


@hookspec
def stereogs_register_initializers(register: Register[c.Initializer[Any]]) -> None:
    """Offer initializers: a scene in, the points that Gaussians start from out."""


@hookspec
def stereogs_register_priors(register: Register[Prior[Any]]) -> None:
    """Offer prior models: frozen estimators of depth, disparity, flow or matches."""


@hookspec
def stereogs_register_samplers(register: Register[c.Sampler[Any]]) -> None:
    """Offer samplers: what an iteration learns from, before its render."""


@hookspec
def stereogs_register_appearances(register: Register[c.Appearance[Any]]) -> None:
    """Offer changes of the rendered colours before they are compared."""


@hookspec
def stereogs_register_regularizers(register: Register[c.Regularizer[Any]]) -> None:
    """Offer loss terms beside the photometric one."""


@hookspec
def stereogs_register_modifiers(register: Register[c.Modifier[Any]]) -> None:
    """Offer modifiers of the training render's opacities."""


@hookspec
def stereogs_register_densifications(register: Register[c.Densification[Any]]) -> None:
    """Offer policies that add, clone, split, move and prune."""


@hookspec
def stereogs_register_opacity_policies(register: Register[c.OpacityPolicy[Any]]) -> None:
    """Offer policies that reset or decay opacities."""


@hookspec
def stereogs_register_perturbations(register: Register[c.Perturbation[Any]]) -> None:
    """Offer moves of parameters after the optimizer's step."""


@hookspec
def stereogs_register_metrics(register: Register[c.ViewMetric[Any]]) -> None:
    """Offer scores of a rendered view against its photograph."""


@hookspec
def stereogs_register_exporters(register: Register[c.Exporter[Any]]) -> None:
    """Offer file formats for the trained Gaussians."""


@hookspec
def stereogs_register_reports(register: Register[c.Report[Any]]) -> None:
    """Offer pages and pictures made from a finished run."""


@hookspec
def stereogs_register_observers(register: Register[c.Observer[Any]]) -> None:
    """Offer loggers and other listeners: they are told how a run goes."""


@hookspec
def stereogs_register_runners(register: Register[Runner[Any]]) -> None:
    """Offer places where trainings run, such as a cluster."""


@hookspec
def stereogs_register_commands(register: Register[Command]) -> None:
    """Offer verbs of the command line. Entry points are in the group `stereogs.commands`."""


@hookspec
def stereogs_register_train_options(register: Register[TrainOption]) -> None:
    """Offer options of `train` and `resume`. Entry points are in the group `stereogs.train_options`."""
