"""Show what a pipeline does, and when."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ...command_line.arguments import add_changes
from ...command_line.command import Command
from ...command_line.output import console

if TYPE_CHECKING:
    from registry.pipeline.pipeline import Item, Pipeline

ARRAYS = 4
"""Numbers stored for each parameter: its value, its gradient, Adam's two moments."""
_NUMBERS = 3 + 4 + 3 + 1
"""Mean, quaternion, scale and opacity of a Gaussian; colours come on top."""
_FLOAT_BYTES = 4
_UNKNOWN_COUNT = 100_000


class Explain(Command):
    epilog = """\
examples:
  stereogs explain 3dgs
  stereogs explain 3dgs --set training.iterations=5000

Lists the components of each stage: package, iterations, inputs, files and priors; then the memory of the
Gaussians, and the pipeline with every default. Nothing is loaded or trained. The exit status is 1 if a file
or a prior is missing, or if a component is never due or called far too often.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "pipeline", type=Path, metavar="PIPELINE", help="a YAML file or a pipeline's name"
        )
        add_changes(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the explanation; return 1 if the pipeline has a fault."""
        from registry.discovery import Plugins
        from registry.messages.visible_text import without_credentials
        from registry.pipeline.faults import faults
        from registry.pipeline.pipeline import load_pipeline

        pipeline = load_pipeline(
            arguments.pipeline, Plugins(), overrides=arguments.set, disabled=arguments.disable
        )
        output = console()
        training, each = pipeline.training, pipeline.iterations_per_view
        length = f"{training.iterations} iterations" + f", {each} per training view" * bool(each)
        output.print(f"{pipeline.name}: {length}, seed {training.seed}")
        for stage, components in explained(pipeline):
            output.print(f"\n{stage}")
            for component in components:
                output.print(f"  {component.name}")
                for label, text in component.notes:
                    output.print(f"    {label:<6} {text}")
        if asked := list(_asked(pipeline)):
            output.print("\nrendered or collected on request")
            for line in asked:
                output.print(f"  {line}")
        output.print(f"\nmemory, estimated\n  {memory(pipeline)}")
        output.print(f"\nthe pipeline in full\n\n{without_credentials(pipeline.to_yaml())}")
        found = faults(pipeline)
        for fault in found:
            output.print(f"fault: {fault}")
        return 1 if found else 0


class Explained(NamedTuple):
    """A component by its qualified name, and notes about it, each as label and text."""

    name: str
    notes: list[tuple[str, str]]


def explained(pipeline: Pipeline) -> Iterator[tuple[str, list[Explained]]]:
    """Yield each stage that has components, with the components."""
    from registry.contract.hook_points import PIPELINE_POINTS, STAGES

    for number, stage in enumerate(STAGES):
        points = sorted((p for p in PIPELINE_POINTS if p.stage == number), key=lambda p: p.late)
        items = [item for point in points for item in pipeline.items[point.section]]
        if items:
            yield stage, [_explained(item, pipeline) for item in items]


def _asked(pipeline: Pipeline) -> Iterator[str]:
    """Yield each output that components declare, with the components and when they use it."""
    from registry.contract.rendered import RENDERED
    from registry.pipeline.faults import rendered_for

    asking = rendered_for(pipeline)
    for name in RENDERED:
        who = [
            f"{item.qualified_name} ({_when(item, pipeline.training.iterations)})"
            for item, names in asking
            if name in names
        ]
        if name == "screen_gradient" and pipeline.training.max_gaussians:
            who.append("training.max_gaussians")
        if who:
            yield f"{name}: {', '.join(who)}"


def memory(pipeline: Pipeline) -> str:
    """Return an estimate of the memory that the Gaussians take, as a sentence."""
    training = pipeline.training
    numbers = _NUMBERS + 3 * (training.sh_degree + 1) ** 2
    each = ARRAYS * _FLOAT_BYTES * numbers * training.fields
    count = training.max_gaussians or _UNKNOWN_COUNT
    bound = "the limit of growth" if training.max_gaussians else "if there were that many"
    return (
        f"{each} bytes a Gaussian for parameters, gradients and moments, SH degree "
        f"{training.sh_degree}, fields {training.fields}: {each * count / 1e6:.0f} MB for {count:,}, "
        f"{bound}; photographs (`stereogs check` counts them), renders and plugins come on top"
    )


def _explained(item: Item, pipeline: Pipeline) -> Explained:
    from registry.contract.prior import usable_priors
    from registry.pipeline.faults import capabilities, needs
    from registry.pipeline.settings_check import paths_of

    from .summaries import summary

    offer = item.offer
    origin = f"{offer.distribution} {offer.version}, {item.place}"
    notes = [("is", summary(offer)), ("from", origin)]
    if item.fallback:
        notes.append(("note", f"a fallback: {item.fallback}"))
    if item.point.scheduled:
        notes.append(("when", _when(item, pipeline.training.iterations)))
    notes.append(("reads", item.point.reads))
    notes += [("file", f"{shown}, {_size(path)}") for path, shown in paths_of(item.settings)]
    for wanted in needs(offer.component):
        names = ", ".join(usable_priors(capabilities(pipeline), wanted)) or "none in the pipeline"
        notes.append(("needs", f"a prior for {' or '.join(wanted)}: {names}"))
    return Explained(item.qualified_name, notes)


def _when(item: Item, iterations: int) -> str:
    due = item.schedule.due_in(iterations)
    if not due or item.host.weight == 0:
        return f"never in {iterations} iterations"
    if len(due) <= 3:
        return f"iteration {', '.join(map(str, due))}"
    return f"iterations {due[0]}, {due[1]} to {due[-1]}, {len(due)} times"


def _size(path: Path) -> str:
    path = path.expanduser()
    if path.is_dir():
        return "a folder"
    return f"{path.stat().st_size / 1e6:.1f} MB" if path.exists() else "which does not exist"
