"""Text about components and pipelines: help, what runs when and what it needs, known faults."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ..contract.component import Component
from ..contract.hook_points import PIPELINE_POINTS, STAGES
from ..contract.prior import chosen_prior, usable_priors
from ..errors import PluginError
from ..messages.suggestions import did_you_mean
from ..pipeline.pipeline import Item, Pipeline, default_schedule, leaves
from ..plugins.discovery import Offer, Plugins

ARRAYS = 4
"""Numbers stored for each parameter: its value, its gradient, Adam's two moments."""
FAR_MORE_OFTEN = 50
"""Largest number of a component's calls, relative to its default schedule; published methods have up to 32
times as many (DNGaussian's pruning)."""
_FLOAT_BYTES = 4
_UNKNOWN_COUNT = 100_000


class Explained(NamedTuple):
    """A component by its qualified name, and notes about it, each as label and text."""

    name: str
    notes: list[tuple[str, str]]


def explained(pipeline: Pipeline) -> Iterator[tuple[str, list[Explained]]]:
    """Yield each stage that has components, with the components."""
    for number, stage in enumerate(STAGES):
        points = sorted((p for p in PIPELINE_POINTS if p.stage == number), key=lambda p: p.late)
        items = [item for point in points for item in pipeline.items[point.section]]
        if items:
            yield stage, [_explained(item, pipeline) for item in items]


def faults(pipeline: Pipeline) -> list[str]:
    """Return the problems that are known before anything is loaded, each in a sentence."""
    found: list[tuple[Item, str]] = []
    for item in pipeline:
        missing = [path for path in leaves(dict(item.settings), Path) if not path.exists()]
        found += [(item, f"{path} does not exist") for path in missing]
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


def memory(pipeline: Pipeline) -> str:
    """Return an estimate of the memory that the Gaussians take, as a sentence."""
    from core_rasterizer.layout import row_count

    training = pipeline.training
    each = ARRAYS * _FLOAT_BYTES * row_count(training.sh_degree) * training.fields
    count = training.max_gaussians or _UNKNOWN_COUNT
    bound = "the limit of growth" if training.max_gaussians else "if there were that many"
    return (
        f"{each} bytes a Gaussian for parameters, gradients and moments, SH degree "
        f"{training.sh_degree}, fields {training.fields}: {each * count / 1e6:.0f} MB for {count:,}, "
        f"{bound}; photographs (`stereogs check` counts them), renders and plugins come on top"
    )


def _explained(item: Item, pipeline: Pipeline) -> Explained:
    offer = item.offer
    origin = f"{offer.distribution} {offer.version}, {item.place}"
    notes = [("is", summary(offer)), ("from", origin)]
    if item.fallback:
        notes.append(("note", f"a fallback: {item.fallback}"))
    if item.point.scheduled:
        notes.append(("when", _when(item, pipeline.training.iterations)))
    notes.append(("reads", item.point.reads))
    notes += [("file", f"{path}, {_size(path)}") for path in leaves(dict(item.settings), Path)]
    for wanted in needs(offer.component):
        names = ", ".join(usable_priors(_capabilities(pipeline), wanted)) or "none in the pipeline"
        notes.append(("needs", f"a prior for {' or '.join(wanted)}: {names}"))
    return Explained(item.qualified_name, notes)


def _is_used(item: Item, pipeline: Pipeline) -> bool:
    due = item.schedule.due_in(pipeline.training.iterations)
    return not item.point.scheduled or bool(due and item.host.weight)


def _when(item: Item, iterations: int) -> str:
    due = item.schedule.due_in(iterations)
    if not due or item.host.weight == 0:
        return f"never in {iterations} iterations"
    if len(due) <= 3:
        return f"iteration {', '.join(map(str, due))}"
    return f"iterations {due[0]}, {due[1]} to {due[-1]}, {len(due)} times"


def _size(path: Path) -> str:
    if path.is_dir():
        return "a folder"
    return f"{path.stat().st_size / 1e6:.1f} MB" if path.exists() else "which does not exist"


def refuse_missing_priors(pipeline: Pipeline) -> None:
    """Raise a PluginError if a needed prior is missing, ambiguous, or has another capability."""
    for _, fault in _prior_faults(pipeline):
        raise fault


def needs(component: type[Component[Any]]) -> list[tuple[str, ...]]:
    """Return the needs of a component, each as the capabilities that satisfy it."""
    return [(need,) if isinstance(need, str) else need for need in component.needs_priors]


def _prior_faults(pipeline: Pipeline) -> Iterator[tuple[Item, PluginError]]:
    """Yield each component whose prior is missing, ambiguous, or has another capability."""
    known = _capabilities(pipeline)
    for item in pipeline:
        if not _is_used(item, pipeline):
            continue
        for wanted in needs(item.offer.component):
            names = leaves(getattr(item.settings, "prior", None), str)
            for name in [*names] or (None,):
                try:
                    chosen_prior(known, wanted, name)
                except PluginError as fault:
                    fault.where = f"{item.offer} at {item.place}"
                    yield item, fault


def _capabilities(pipeline: Pipeline) -> dict[str, str | None]:
    return {
        item.name: getattr(item.offer.component, "capability", None)
        for item in pipeline.items["priors"]
    }


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
    return sentence if f"`{offer.name}`" in names else own.partition("\n")[0]


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
