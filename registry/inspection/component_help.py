"""A component in words: what it is for, and its settings with their defaults."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterator

from ..contract.component import Settings
from ..errors import PluginError
from ..messages.suggestions import did_you_mean
from ..plugins.discovery import Offer, Plugins


def component_help(name: str, plugins: Plugins) -> str:
    """Every component of that name, one after the other; lines as their authors broke them.

    Raises:
        PluginError: there is none.
    """
    offers = plugins.all()
    found = [offer for offer in offers if offer.name == name]
    if not found:
        raise PluginError(
            f"no plugin offers {name!r}{did_you_mean(name, [offer.name for offer in offers])}",
            where="the command line",
            fix="`stereogs plugins` lists what there is",
        )
    return "\n".join("\n".join([*_lines(offer), ""]) for offer in found)


def summary(offer: Offer) -> str:
    """What a component is for, in a sentence.

    Its module's, if that begins "`name`: ..."; else the first line of what it says of itself.
    """
    module = inspect.getdoc(sys.modules[offer.component.__module__]) or ""
    names, _, sentence = " ".join(module.partition("\n\n")[0].split()).partition(": ")
    own = inspect.getdoc(offer.component) or ""
    return sentence if f"`{offer.name}`" in names else own.partition("\n")[0]


def _lines(offer: Offer) -> Iterator[str]:
    yield f"{offer.name}: {offer.point.title} ({offer.distribution} {offer.version})"
    yield ""
    own = inspect.cleandoc(offer.component.__doc__ or "")
    if not own.startswith(in_a_sentence := summary(offer)):
        yield from (in_a_sentence, "")
    yield from own.splitlines()
    yield ""
    yield f"settings, in the pipeline's section `{offer.point.section}`:"
    if not offer.settings_type.model_fields:
        yield "  none of its own"
    yield from _settings(offer.settings_type, "  ")
    yield f"lent by the host: {', '.join(offer.point.host_settings)}"


def _settings(model: type[Settings], indent: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        default = "required"
        if not field.is_required():
            default = json.dumps(field.get_default(call_default_factory=True), default=str)
        yield (
            f"{indent}{name} = {default}" if default != "required" else f"{indent}{name} (required)"
        )
        for line in inspect.cleandoc(field.description or "").splitlines():
            yield f"{indent}    {line}"
