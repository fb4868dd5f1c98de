"""Faults of a pipeline that are known before anything is loaded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ..calls.blame import blame
from ..contract.component import Component
from ..contract.hook_points import LOSS, OPTIMIZER, RENDER
from ..contract.prior import chosen_prior
from ..contract.rendered import COLLECTED, RENDERED, Rendered
from ..errors import PluginError
from ..messages.suggestions import counted, did_you_mean
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
    for item, earlier, both in _spent_statistics(rendered_for(pipeline), pipeline):
        if not _never_read(item, earlier, both, pipeline.training.iterations):
            what = f"is left out in {counted(len(both), 'iteration')}, first {min(both)}, in which "
            what += f"the edit of {earlier.name!r} resets the screen gradients that it reads"
            found.append((item, f"{what} ({item.place})"))
    unmet = (*_prior_faults(pipeline), *rendered_faults(pipeline))
    found += [(item, error.what) for item, error in unmet]
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


def refuse_unmet_needs(pipeline: Pipeline, *, absolute_gradients: bool = True) -> None:
    """Raise a PluginError if a component lacks a prior, or an output that it declares cannot be made.

    Args:
        absolute_gradients: whether the engine collects them (`Engine.absolute_gradients`).
    """
    for _, fault in (*_prior_faults(pipeline), *rendered_faults(pipeline)):
        raise fault
    for item, names in rendered_for(pipeline):
        if "absolute_screen_gradient" in names and not absolute_gradients:
            raise PluginError(
                "it needs 'absolute_screen_gradient', which the engine of this run does not collect",
                where=str(item),
                fix="train with the OpenCL engine, or change its settings (see `stereogs explain`)",
            )


def rendered_for(pipeline: Pipeline) -> list[tuple[Item, tuple[Rendered, ...]]]:
    """Return the components that are due in some iteration, with the outputs that each declares, if any."""
    training = [i for i in pipeline if i.point.stage is not None and i.point.scheduled]
    due = [i for i in training if i.schedule.due_in(pipeline.training.iterations) and i.host.weight]
    return [(item, names) for item in due if (names := needs_rendered(item))]


def needs_rendered(item: Item) -> tuple[Rendered, ...]:
    """Return the outputs that a component declares with its settings (`Component.needs_rendered`)."""
    with blame(item):
        return tuple(item.offer.component.needs_rendered(item.settings))


def rendered_faults(pipeline: Pipeline) -> Iterator[tuple[Item, PluginError]]:
    """Yield each component that declares an output which it cannot get."""
    asking = rendered_for(pipeline)
    for item, names in asking:
        for name in names:
            if fault := _unavailable(item, name, pipeline.training.fields):
                yield item, PluginError(fault[0], where=str(item), fix=fault[1])
    for item, earlier, both in _spent_statistics(asking, pipeline):
        if _never_read(item, earlier, both, pipeline.training.iterations):
            what = f"it needs screen gradients, but in each of its iterations, first {min(both)}, "
            what += f"the edit of {earlier.name!r} at {earlier.place} resets them before"
            fix = "list it first, or give one of them another `phase`"
            yield item, PluginError(what, where=str(item), fix=fix)


def _unavailable(item: Item, name: str, fields: int) -> tuple[str, str] | None:
    """Return why a component cannot get an output, and what to do; None if it can."""
    stage = item.point.stage
    if name not in RENDERED:
        meant = did_you_mean(name, RENDERED)
        return f"it declares {name!r}, which does not exist{meant}", f"use {', '.join(RENDERED)}"
    if stage is None or not (RENDER if name in COLLECTED else LOSS) <= stage <= OPTIMIZER:
        when = "before the render" if stage == RENDER else "outside the iterations"
        return (
            f"it needs {name!r}, but a {item.point.title} is called {when}",
            "make it a regularizer or a policy",
        )
    if name == "other_fields" and fields < 2:
        return (
            "it needs 'other_fields', but training has a single field",
            f"set `training.fields` to 2, or switch it off with `--disable {item.name}`",
        )
    if name == "other_fields" and item.host.step == "alone":
        return (
            "it needs 'other_fields', which are rendered after the regularizers with `step: alone`",
            "remove `step: alone`",
        )
    return None


def _spent_statistics(
    asking: Sequence[tuple[Item, tuple[Rendered, ...]]], pipeline: Pipeline
) -> Iterator[tuple[Item, Item, set[int]]]:
    """Yield (reader, earlier policy, iterations in which the earlier's edit resets what the reader reads)."""
    reading = [item for item, names in asking if COLLECTED & {*names}]
    policies = pipeline.items["densification"]
    for number, item in enumerate(policies):
        for earlier in policies[:number] if item in reading else ():
            dues = ({*of.schedule.due_in(pipeline.training.iterations)} for of in (earlier, item))
            if both := set.intersection(*dues):
                yield item, earlier, both


def _never_read(item: Item, earlier: Item, both: set[int], iterations: int) -> bool:
    """Return whether a policy never reads statistics because of an earlier one.

    Shares of a run of a few iterations are rounded so that the earlier is due in every one, which is no
    mistake of the pipeline.
    """
    return len(both) == len(item.schedule.due_in(iterations)) and earlier.schedule.every > 1


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
                    fault.where = str(item)
                    yield item, fault


def capabilities(pipeline: Pipeline) -> dict[str, str | None]:
    """Return the capability of each prior by its name; None for a prior without one."""
    return {
        item.name: getattr(item.offer.component, "capability", None)
        for item in pipeline.items["priors"]
    }
