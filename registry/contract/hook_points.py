"""The hook points as a table: which section of a pipeline each fills, and what the host lends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from . import components as c
from .component import Component
from .prior import Prior

API_VERSION = 1
"""Version of the plugin API. Raised when a plugin written for the one before would break."""


@dataclass(frozen=True)
class HookPoint:
    """One kind of component.

    Args:
        section: the key in a pipeline.
        title: what a component of this kind is called in messages.
        hook: the hook through which plugins offer components.
        base: the class that a component derives from.
        many: the section holds a list; otherwise a single component.
        required: a pipeline cannot do without.
        scheduled: the host lends `start`, `stop` and `every`.
        weighted: the host lends `weight`.
    """

    section: str
    title: str
    hook: str
    base: type[Component[Any]]
    many: bool = True
    required: bool = False
    scheduled: bool = False
    weighted: bool = False

    @property
    def host_settings(self) -> tuple[str, ...]:
        """Settings that belong to the host; a component may not define them."""
        names: tuple[str, ...] = ("use", "name", "enabled")
        if self.weighted:
            names += ("weight",)
        if self.scheduled:
            names += ("start", "stop", "every")
        return names


HOOK_POINTS: tuple[HookPoint, ...] = (
    HookPoint(
        "scene",
        "scene loader",
        "stereogs_register_scenes",
        c.SceneLoader,
        many=False,
        required=True,
    ),
    HookPoint(
        "initializer",
        "initializer",
        "stereogs_register_initializers",
        c.Initializer,
        many=False,
        required=True,
    ),
    HookPoint("priors", "prior", "stereogs_register_priors", Prior),
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
        many=False,
        scheduled=True,
    ),
    HookPoint(
        "opacity",
        "opacity policy",
        "stereogs_register_opacity_policies",
        c.OpacityPolicy,
        many=False,
        scheduled=True,
    ),
    HookPoint("metrics", "metric", "stereogs_register_metrics", c.ViewMetric),
    HookPoint("exporters", "exporter", "stereogs_register_exporters", c.Exporter),
    HookPoint("reports", "report", "stereogs_register_reports", c.Report),
)
"""In the order in which a pipeline is written."""
