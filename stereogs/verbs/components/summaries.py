"""Purpose and settings of components, from their docstrings."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterator

from pydantic import BaseModel

from registry import PluginError
from registry.discovery import Offer, Plugins
from registry.messages.suggestions import did_you_mean
from registry.pipeline.training_settings import TrainingSettings

TRAINING = "training"
"""The section of a pipeline whose settings are the host's."""


def component_help(name: str, plugins: Plugins) -> str:
    """Return the help of every component of that name, or of the section `training`.

    Lines are broken as in the docstrings.

    Raises:
        PluginError: there is no such component.
    """
    if name == TRAINING:
        lines = (f"settings of the section `{TRAINING}`:", *_settings(TrainingSettings), "")
        return "\n".join(lines)
    offers = plugins.all()
    found = [offer for offer in offers if offer.name == name]
    if not found:
        raise PluginError(
            f"no plugin offers {name!r}{did_you_mean(name, [TRAINING, *(offer.name for offer in offers)])}",
            where="the command line",
            fix="`stereogs plugins` lists all components",
        )
    return "\n".join("\n".join([*_help_lines(offer), ""]) for offer in found)


def summary(offer: Offer) -> str:
    """Return the purpose of a component in a sentence.

    Taken from the module's docstring if that begins "`name`: ..."; else the first line of the class's.
    """
    module = inspect.getdoc(sys.modules[offer.component.__module__]) or ""
    names, _, sentence = " ".join(module.partition("\n\n")[0].split()).partition(": ")
    own = inspect.getdoc(offer.component) or ""
    return sentence if sentence and f"`{offer.name}`" in names else own.partition("\n")[0]


def _help_lines(offer: Offer) -> Iterator[str]:
    yield f"{offer.name}: {offer.point.title} ({offer.distribution} {offer.version})"
    yield ""
    own = inspect.cleandoc(offer.component.__doc__ or "")
    if not own.startswith(sentence := summary(offer)):
        yield from (sentence, "")
    yield from own.splitlines()
    yield ""
    yield f"settings, in the pipeline's section `{offer.point.section}`:"
    yield from list(_settings(offer.settings_type)) or ["  none of its own"]
    yield f"settings that the host reads: {', '.join(offer.point.host_settings)}"
    if defaults := str(offer.component.host_defaults):
        yield f"their defaults: {defaults}"


def _settings(settings: type[BaseModel], within: str = "") -> Iterator[str]:
    for name, field in settings.model_fields.items():
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        if field.is_required():
            yield f"  {within}{name} (required)"
        elif isinstance(default, BaseModel):
            yield f"  {within}{name}:"
        else:
            yield f"  {within}{name} = {json.dumps(default, default=str)}"
        for line in inspect.cleandoc(field.description or "").splitlines():
            yield f"      {line}"
        if isinstance(default, BaseModel):
            yield from _settings(type(default), f"{within}{name}.")
