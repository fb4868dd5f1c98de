"""The hook points as a table: which section of a pipeline each fills, and what the host lends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ..runners import Runner
from . import components as c
from .component import Component
from .prior import Prior

API_VERSION = 3
"""Version of the plugin API. Raised when a plugin written for the one before could break.

3: verbs and train options are plugins; prior models, events, runners and building blocks are imported from
`registry.priors`, `registry.events`, `registry.runners` and `registry.toolkit`.
2: samplers, appearances, perturbations, parameters of components, terms stepped alone, several fields,
edits that add, relocate and split into more than two, optical flow and matches; components see a
scene without test views and true depth and Gaussians that cannot be written to; scenes have facts in
place of notes; each component has an entry point of its own name.
"""


@dataclass(frozen=True)
class HookPoint:
    """One kind of component.

    Args:
        section: the key in a pipeline.
        title: what a component of this kind is called in messages.
        hook: the hook through which plugins offer components.
        base: the class that a component derives from.
        holds: whether the section holds one component, a list, or either as it is written.
        required: a pipeline cannot do without.
        scheduled: the host lends `start`, `stop` and `every`.
        weighted: the host lends `weight` and `step`.
        observes: it is told what happens and takes no part in it: a run has it once, whatever number of
            fields of Gaussians, and may be resumed without it.
        in_pipeline: False for what a pipeline does not name, because it trains whole pipelines.
    """

    section: str
    title: str
    hook: str
    base: type[Component[Any]]
    holds: Literal["one", "list", "one or list"] = "list"
    required: bool = False
    scheduled: bool = False
    weighted: bool = False
    observes: bool = False
    in_pipeline: bool = True

    @property
    def host_settings(self) -> tuple[str, ...]:
        """Settings that belong to the host; a component may not define them."""
        names: tuple[str, ...] = ("use", "name", "enabled")
        if self.weighted:
            names += ("weight", "step")
        if self.scheduled:
            names += ("start", "stop", "every", "phase")
        return names


HOOK_POINTS: tuple[HookPoint, ...] = (
    HookPoint(
        "scene",
        "scene loader",
        "stereogs_register_scenes",
        c.SceneLoader,
        holds="one",
        required=True,
    ),
    HookPoint(
        "initializer",
        "initializer",
        "stereogs_register_initializers",
        c.Initializer,
        holds="one",
        required=True,
    ),
    HookPoint("priors", "prior", "stereogs_register_priors", Prior),
    HookPoint("samplers", "sampler", "stereogs_register_samplers", c.Sampler, scheduled=True),
    HookPoint(
        "appearances", "appearance", "stereogs_register_appearances", c.Appearance, scheduled=True
    ),
    HookPoint(
        "regularizers",
        "regularizer",
        "stereogs_register_regularizers",
        c.Regularizer,
        scheduled=True,
        weighted=True,
    ),
    HookPoint("modifiers", "modifier", "stereogs_register_modifiers", c.Modifier, scheduled=True),
    HookPoint(
        "densification",
        "densification",
        "stereogs_register_densifications",
        c.Densification,
        holds="one or list",
        scheduled=True,
    ),
    HookPoint(
        "opacity",
        "opacity policy",
        "stereogs_register_opacity_policies",
        c.OpacityPolicy,
        holds="one or list",
        scheduled=True,
    ),
    HookPoint(
        "perturbations",
        "perturbation",
        "stereogs_register_perturbations",
        c.Perturbation,
        scheduled=True,
    ),
    HookPoint("metrics", "metric", "stereogs_register_metrics", c.ViewMetric),
    HookPoint("exporters", "exporter", "stereogs_register_exporters", c.Exporter),
    HookPoint("reports", "report", "stereogs_register_reports", c.Report),
    HookPoint(
        "observers",
        "observer",
        "stereogs_register_observers",
        c.Observer,
        scheduled=True,
        observes=True,
    ),
    HookPoint(
        "runner", "runner", "stereogs_register_runners", Runner, holds="one", in_pipeline=False
    ),
)
PIPELINE_POINTS = tuple(point for point in HOOK_POINTS if point.in_pipeline)
"""In the order in which a pipeline is written."""
