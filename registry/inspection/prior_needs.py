"""Priors that the components of a pipeline need."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..contract.component import Component
from ..errors import PluginError
from ..pipeline.pipeline import Item, Pipeline


def refuse_missing_priors(pipeline: Pipeline) -> None:
    """Raise the first of `prior_faults`, before anything is loaded."""
    for _, fault in prior_faults(pipeline):
        raise fault


def prior_faults(pipeline: Pipeline) -> Iterator[tuple[Item, PluginError]]:
    """Yield each component whose prior is missing, ambiguous, or has another capability."""
    for item in pipeline:
        training = item.point.scheduled
        if training and not item.schedule.ever_due(pipeline.training.iterations):
            continue
        if training and item.host.weight == 0:
            continue
        for wanted in needs(item.offer.component):
            found = _fault(pipeline, wanted, _names(getattr(item.settings, "prior", None)))
            if found is not None:
                what, fix = found
                where = f"{item.offer} at {item.place}"
                yield item, PluginError(what, where=where, fix=fix)


def needs(component: type[Component[Any]]) -> list[tuple[str, ...]]:
    """Return the needs of a component, each as the capabilities that satisfy it."""
    return [(need,) if isinstance(need, str) else need for need in component.needs_priors]


def able(pipeline: Pipeline, wanted: tuple[str, ...]) -> list[str]:
    """Return the names of the priors that satisfy a need; the first capability that any has decides."""
    known = _capabilities(pipeline)
    found = ([name for name, own in known.items() if own == capability] for capability in wanted)
    return next((names for names in found if names), [])


def _capabilities(pipeline: Pipeline) -> dict[str, str | None]:
    return {
        item.name: getattr(item.offer.component, "capability", None)
        for item in pipeline.items["priors"]
    }


def _names(setting: Any) -> list[str]:
    """Return all names in a setting `prior`: a name, a sequence, or a mapping to names."""
    if isinstance(setting, str):
        return [setting]
    values = setting.values() if isinstance(setting, dict) else setting or ()
    return [name for value in values for name in _names(value)]


def _fault(pipeline: Pipeline, wanted: tuple[str, ...], names: list[str]) -> tuple[str, str] | None:
    """Return what is wrong and how to fix it, in the words of `Prior.choose`."""
    known, capability = _capabilities(pipeline), " or ".join(map(repr, wanted))
    listed = ", ".join(f"{name} ({own})" for name, own in known.items()) or "none"
    for name in names:
        if name not in known:
            what = f"there is no prior named {name!r}; {capability} is needed"
        elif known[name] not in wanted:
            what = f"the prior {name!r} has the capability {known[name]!r}; {capability} is needed"
        else:
            continue
        return what, f"name one that has it; the pipeline's priors are: {listed}"
    usable = able(pipeline, wanted)
    if names or len(usable) == 1:
        return None
    if usable:
        what = f"{len(usable)} priors have the capability {capability}"
        return what, f"choose with `prior: NAME`, one of {', '.join(usable)}"
    return (
        f"a prior with the capability {capability} is needed, and the pipeline has none",
        f"add one under `priors:`; `stereogs plugins` lists them (the pipeline's: {listed})",
    )
