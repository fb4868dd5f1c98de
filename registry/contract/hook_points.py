"""Table of the hooks with which plugins register components.

A plugin module implements a hook for each kind of component that it offers. The hook receives
`register(name, component_class)` and calls it once for each component. Users write the name after `use:`
in a pipeline; it is unique within its hook point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Protocol, TypeVar

import pluggy

from ..confidence import ConfidenceEstimator
from ..runners import Runner
from . import components as c
from .checks import answers as a
from .checks.scene import check_initialization, validate
from .component import Component
from .prior import Prior

API_VERSION = 1
"""Version of the plugin API; increased when plugins for the previous version could break."""

PROJECT = "stereogs"
hookimpl = pluggy.HookimplMarker(PROJECT)
OTHER_HOOKS = ("stereogs_register_commands", "stereogs_register_train_options")
"""Hooks for verbs and for options of `train`; see `stereogs.command_line.command`."""

Registered = TypeVar("Registered", contravariant=True)


class Register(Protocol[Registered]):
    """The argument of a hook. Call it once for each component."""

    def __call__(self, name: str, offered: type[Registered], /) -> None: ...


STAGES = (
    "before training",
    "in an iteration, before the render",
    "in an iteration, for the loss",
    "in an iteration, after the backward pass",
    "in an iteration, after the optimizer's step",
    "after training",
    "observers: notified during the run, cannot change it",
)
"""When components are called, in this order."""
BEFORE, RENDER, LOSS, BACKWARD, OPTIMIZER, AFTER, DURING = range(len(STAGES))


def _accepted(answer: Any, *given: Any) -> Any:
    """Check nothing."""
    return answer


@dataclass(frozen=True)
class HookPoint:
    """One kind of component: when and how it is called, and what a pipeline may say about it.

    Args:
        section: key in a pipeline.
        title: name of this kind in messages.
        offers: last part of the hook's name, `stereogs_register_OFFERS`.
        base: class that a component derives from.
        stage: index in `STAGES`; None for a kind that pipelines do not name.
        reads: data that a component receives, for `stereogs explain`.
        method: the one whose answer the host uses; "" for priors, which components call, and for observers.
        check: takes the answer and what the method received; returns the checked answer, or raises an
            `ExplainedError`.
        holds: number of components in the section: one, a list, or either.
        required: True if a pipeline must have one.
        scheduled: True if it accepts `start`, `stop`, `every` and `phase`.
        weighted: True if it accepts `weight` and `step`.
        late: True if it is called after the other kinds of its stage.
    """

    section: str
    title: str
    offers: str
    base: type[Component[Any]]
    stage: int | None
    reads: str
    method: str = ""
    check: Callable[..., Any] = _accepted
    holds: Literal["one", "list", "one or list"] = "list"
    required: bool = False
    scheduled: bool = False
    weighted: bool = False
    late: bool = False

    @property
    def hook(self) -> str:
        """Name of the function that a plugin implements."""
        return f"stereogs_register_{self.offers}"

    @property
    def in_pipeline(self) -> bool:
        """False for runners and confidence estimators, which commands and other components use."""
        return self.stage is not None

    @property
    def observes(self) -> bool:
        """True for observers: one per run, whatever the number of fields; a run resumes without it."""
        return self.stage == DURING

    @property
    def host_settings(self) -> tuple[str, ...]:
        """Settings that the host reads; a component must not define them."""
        names: tuple[str, ...] = ("use", "name", "enabled")
        if self.section == "priors":
            names += ("fallbacks",)
        if self.weighted:
            names += ("weight", "step")
        if self.scheduled:
            names += ("start", "stop", "every", "phase")
        return names


_in_loop = partial(HookPoint, scheduled=True)

# fmt: off
HOOK_POINTS: tuple[HookPoint, ...] = (
    HookPoint("scene", "scene loader", "scenes", c.SceneLoader, BEFORE,
              "the files that it names", "load", validate, holds="one", required=True),
    HookPoint("initializer", "initializer", "initializers", c.Initializer, BEFORE,
              "training views, their points, bounds; priors", "initialize", check_initialization,
              holds="one", required=True, late=True),
    HookPoint("priors", "prior", "priors", Prior, BEFORE,
              "images and views that its callers pass"),
    _in_loop("samplers", "sampler", "samplers", c.Sampler, RENDER,
             "the step and its sample: view, camera, target, background", "sample", a.check_sample),
    _in_loop("appearances", "appearance", "appearances", c.Appearance, LOSS,
             "the step, the render and its colours", "colors", a.check_colors),
    _in_loop("regularizers", "regularizer", "regularizers", c.Regularizer, LOSS,
             "the step, the render, other fields; may render more views", "loss", a.check_loss,
             weighted=True),
    _in_loop("modifiers", "modifier", "modifiers", c.Modifier, RENDER,
             "the step: scene, sample, Gaussians, priors", "opacity_scale", a.check_opacity_scale),
    _in_loop("densification", "densification", "densifications", c.Densification, BACKWARD,
             "the step, the Gaussians and their gradients", "refine", a.check_edit,
             holds="one or list", late=True),
    _in_loop("opacity", "opacity policy", "opacity_policies", c.OpacityPolicy, BACKWARD,
             "the step, the Gaussians and their gradients", "update", a.check_opacity_update,
             holds="one or list"),
    _in_loop("perturbations", "perturbation", "perturbations", c.Perturbation, OPTIMIZER,
             "the step, the Gaussians, learning rates", "offsets", a.check_offsets),
    HookPoint("metrics", "metric", "metrics", c.ViewMetric, AFTER,
              "renders of test and training views, the scene with its true depth", "measure_view",
              a.check_score),
    HookPoint("exporters", "exporter", "exporters", c.Exporter, AFTER, "the Gaussians, the scene",
              "export", a.check_files),
    HookPoint("reports", "report", "reports", c.Report, AFTER, "the run folder, the scene", "write",
              a.check_files),
    _in_loop("observers", "observer", "observers", c.Observer, DURING,
             "start and end, scores; of each iteration the losses, the render, the Gaussians"),
    HookPoint("runner", "runner", "runners", Runner, None, "pipelines to train", "start", holds="one"),
    HookPoint("confidence", "confidence estimator", "confidence_estimators", ConfidenceEstimator, None,
              "the Gaussians, the training views, a camera", "estimate", holds="one"),
)
# fmt: on
PIPELINE_POINTS = tuple(point for point in HOOK_POINTS if point.in_pipeline)
"""In the order of the sections in a pipeline."""
