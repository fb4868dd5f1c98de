"""What a pipeline will do, told before it does it: what runs when, what it reads and needs, what it takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..contract.hook_points import PIPELINE_POINTS, STAGES
from ..pipeline.pipeline import Item, Pipeline
from .component_help import summary
from .prior_needs import able, needs, prior_faults

ARRAYS = 4
"""Numbers kept for each parameter: itself, its gradient, Adam's two moments."""
_FLOAT_BYTES = 4
_UNKNOWN_COUNT = 100_000


@dataclass(frozen=True)
class Explained:
    """One component of a pipeline.

    Args:
        name: in the pipeline, for example "regularizers.stereo_depth".
        notes: what it is, when it is asked, what it reads and needs; label and text.
    """

    name: str
    notes: tuple[tuple[str, str], ...]


def explained(pipeline: Pipeline) -> Iterator[tuple[str, tuple[Explained, ...]]]:
    """Each stage that has something to do, with its components."""
    for number, stage in enumerate(STAGES):
        points = sorted((p for p in PIPELINE_POINTS if p.stage == number), key=lambda p: p.late)
        items = [item for point in points for item in pipeline.items[point.section]]
        if items:
            yield stage, tuple(_explained(item, pipeline) for item in items)


def faults(pipeline: Pipeline) -> list[str]:
    """What can be known to go wrong, or to come to nothing, before anything is loaded."""
    found = []
    for item in pipeline:
        found += [
            f"{item.qualified_name}: {path} does not exist"
            for path in _paths(item)
            if not path.exists()
        ]
        if item.point.scheduled and not _due(item, pipeline):
            found.append(f"{item.qualified_name}: is never due")
    found += [f"{item.qualified_name}: {fault.what}" for item, fault in prior_faults(pipeline)]
    return found


def memory(pipeline: Pipeline) -> str:
    """An estimate of what the Gaussians take, in words."""
    from core_rasterizer.layout import row_count

    training = pipeline.training
    each = ARRAYS * _FLOAT_BYTES * row_count(training.sh_degree) * training.fields
    count = training.max_gaussians or _UNKNOWN_COUNT
    bound = "at most (max_gaussians)" if training.max_gaussians else "if there were that many"
    return (
        f"{each} bytes a Gaussian for parameters, gradients and moments, SH degree "
        f"{training.sh_degree}, fields {training.fields}: {each * count / 1e6:.0f} MB for {count:,}, "
        f"{bound}; photographs (`stereogs check` counts them), renders and plugins come on top"
    )


def _explained(item: Item, pipeline: Pipeline) -> Explained:
    component = item.offer.component
    notes = [("is", summary(item.offer))]
    notes.append(("from", f"{item.offer.distribution} {item.offer.version}, {item.place}"))
    if item.point.scheduled:
        notes.append(("when", _when(item, pipeline)))
    notes.append(("reads", item.point.reads))
    notes += [("file", f"{path}, {_size(path)}") for path in _paths(item)]
    for wanted in needs(component):
        names = ", ".join(able(pipeline, wanted)) or "none in the pipeline"
        notes.append(("needs", f"a prior for {' or '.join(wanted)}: {names}"))
    return Explained(item.qualified_name, tuple(notes))


def _due(item: Item, pipeline: Pipeline) -> list[int]:
    """The iterations in which a component is called."""
    if item.host.weight == 0:
        return []
    return [n for n in range(1, pipeline.training.iterations + 1) if item.schedule.due(n)]


def _when(item: Item, pipeline: Pipeline) -> str:
    due = _due(item, pipeline)
    if not due:
        return f"never in {pipeline.training.iterations} iterations"
    if len(due) <= 3:
        return f"iteration {', '.join(map(str, due))}"
    return f"iterations {due[0]}, {due[1]} to {due[-1]}, {len(due)} times"


def _paths(item: Item) -> list[Path]:
    """Every path among the settings, in mappings and sequences too."""
    return list(_paths_in([value for _, value in item.settings]))


def _paths_in(value: Any) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif isinstance(value, Mapping):
        yield from _paths_in(list(value.values()))
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _paths_in(inner)


def _size(path: Path) -> str:
    if path.is_dir():
        return "a folder"
    return f"{path.stat().st_size / 1e6:.1f} MB" if path.exists() else "which does not exist"
