"""The page of the site that lists all components and their settings, generated from the code."""

from __future__ import annotations

import inspect
import json
from typing import Any

from pydantic.fields import FieldInfo

from registry import Settings
from registry.contract.hook_points import HOOK_POINTS
from registry.discovery import Offer, Plugins
from registry.pipeline.schedule import HostSettings
from registry.pipeline.training_settings import LearningRates, TrainingSettings

PACKAGE = "stereogs-plugins"

_HEAD = """\
# Components and their settings

The components of this project, by section of the pipeline. `stereogs plugins` also lists those of other
installed packages.
"""


def page() -> str:
    """Return the page as Markdown."""
    offers = [offer for offer in Plugins().all() if offer.distribution == PACKAGE]
    parts = [_HEAD]
    for point in HOOK_POINTS:
        mine = [offer for offer in offers if offer.point is point]
        one = f"one {point.title}"
        number = {"list": "a list", "one": one, "one or list": f"{one} or a list"}[point.holds]
        parts.append(f"## `{point.section}`: {number}\n")
        names = ", ".join(f"`{name}`" for name in point.host_settings)
        parts.append(f"[Host settings](#host-settings): {names}.\n")
        parts.extend(_component(offer) for offer in mine)
        if not mine:
            parts.append("None.\n")
    parts.append("## Host settings\n")
    parts.append(_table(HostSettings))
    parts.append("## `training`\n")
    parts.append(_table(TrainingSettings))
    parts.append("## `training.learning_rates`\n")
    parts.append(_table(LearningRates))
    return "\n".join(parts)


def _component(offer: Offer) -> str:
    summary = inspect.cleandoc(offer.component.__doc__ or "")
    parts = [f"### {offer.name}\n\n{summary}\n\n{_table(offer.settings_type)}"]
    if defaults := str(offer.component.host_defaults):
        parts.append(f"Defaults of host settings: `{defaults}`.\n")
    for name, field in offer.settings_type.model_fields.items():
        if isinstance(nested := field.get_default(call_default_factory=True), Settings):
            parts.append(f"#### `{offer.name}`: `{name}`\n\n{_table(type(nested))}")
    return "\n".join(parts)


def _table(settings: type[Settings]) -> str:
    if not settings.model_fields:
        return "No settings.\n"
    rows = [
        f"| `{name}` | {_default(field)} | {' '.join((field.description or '').split())} |"
        for name, field in settings.model_fields.items()
    ]
    return "\n".join(["| setting | default | meaning |", "|---|---|---|", *rows]) + "\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value: Any = field.get_default(call_default_factory=True)
    if isinstance(value, Settings):
        return "see below"
    return f"`{json.dumps(value, default=str)}`"
