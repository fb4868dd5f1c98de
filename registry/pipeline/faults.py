"""Faults of a pipeline that are known before anything is loaded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..contract.component import Component
from ..contract.prior import chosen_prior
from ..errors import PluginError
from .pipeline import Item, Pipeline, default_schedule
from .settings_check import leaves, paths_of

FAR_MORE_OFTEN = 50
"""Largest number of a component's calls, relative to its default schedule; published methods have up to 32
times as many (DNGaussian's pruning)."""


def faults(pipeline: Pipeline) -> list[str]:
    """Return the problems that are known before anything is loaded, each in a sentence."""
    found: list[tuple[Item, str]] = []
    for item in pipeline:
        paths = paths_of(item.settings)
        missing = [shown for path, shown in paths if not path.expanduser().exists()]
        hint = "; see `stereogs models`" if item.point.section == "priors" else ""
        found += [(item, f"{shown} does not exist{hint}") for shown in missing]
        if item.point.scheduled and (fault := _schedule_fault(item, pipeline.training.iterations)):
            found.append((item, f"{fault} ({item.place})"))
    found += [(item, error.what) for item, error in _prior_faults(pipeline)]
    return [f"{item.qualified_name}: {fault}" for item, fault in found]


def _schedule_fault(item: Item, iterations: int) -> str | None:
    """Return what is wrong if a component is never called, or far more often than by its default schedule."""
    calls = len(item.schedule.due_in(iterations)) if item.host.weight else 0
    if not calls:
        return f"is never due in {iterations} iterations"
    usual = len(default_schedule(item.offer, iterations).due_in(iterations))
    if calls <= FAR_MORE_OFTEN * max(usual, 1):
        return None
    return (
        f"is called {calls} times in {iterations} iterations, but {usual} times by its default schedule; "
        "so many calls spoil the result: remove its `start`, `stop`, `every` and `phase`"
    )


def refuse_missing_priors(pipeline: Pipeline) -> None:
    """Raise a PluginError if a needed prior is missing, ambiguous, or has another capability."""
    for _, fault in _prior_faults(pipeline):
        raise fault


def needs(component: type[Component[Any]]) -> list[tuple[str, ...]]:
    """Return the needs of a component, each as the capabilities that satisfy it."""
    return [(need,) if isinstance(need, str) else need for need in component.needs_priors]


def _prior_faults(pipeline: Pipeline) -> Iterator[tuple[Item, PluginError]]:
    """Yield each component whose prior is missing, ambiguous, or has another capability."""
    known = capabilities(pipeline)
    for item in pipeline:
        due = item.schedule.due_in(pipeline.training.iterations)
        if item.point.scheduled and not (due and item.host.weight):
            continue
        for wanted in needs(item.offer.component):
            names = leaves(getattr(item.settings, "prior", None), str)
            for name in [*names] or (None,):
                try:
                    chosen_prior(known, wanted, name)
                except PluginError as fault:
                    fault.where = f"{item.offer} at {item.place}"
                    yield item, fault


def capabilities(pipeline: Pipeline) -> dict[str, str | None]:
    """Return the capability of each prior by its name; None for a prior without one."""
    return {
        item.name: getattr(item.offer.component, "capability", None)
        for item in pipeline.items["priors"]
    }
