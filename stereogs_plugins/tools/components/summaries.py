"""Purpose and settings of components, from their docstrings."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterator

from registry import PluginError
from registry.messages import did_you_mean
from registry.plugins import Offer, Plugins


def component_help(name: str, plugins: Plugins) -> str:
    """Return the help of every component of that name; lines are broken as in the docstrings.

    Raises:
        PluginError: there is no such component.
    """
    offers = plugins.all()
    found = [offer for offer in offers if offer.name == name]
    if not found:
        raise PluginError(
            f"no plugin offers {name!r}{did_you_mean(name, [offer.name for offer in offers])}",
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
    fields = offer.settings_type.model_fields
    if not fields:
        yield "  none of its own"
    for name, field in fields.items():
        if field.is_required():
            yield f"  {name} (required)"
        else:
            default = field.get_default(call_default_factory=True)
            yield f"  {name} = {json.dumps(default, default=str)}"
        for line in inspect.cleandoc(field.description or "").splitlines():
            yield f"      {line}"
    yield f"settings that the host reads: {', '.join(offer.point.host_settings)}"
    if (defaults := offer.component.host_defaults) != "{}":
        yield f"their defaults: {defaults.strip('{}')}"
