"""The verbs `explain` and `plugins`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.command import Command
from .arguments import add_changes, add_verb
from .output import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from ..plugins.discovery import Offer

FAULT = 1


class Explain(Command):
    """Show what a pipeline does, and when."""

    epilog = """\
examples:
  stereogs explain pipelines/3dgs.yaml
  stereogs explain pipelines/3dgs.yaml --set training.iterations=5000

Lists the components of each stage: package, iterations, inputs, files and priors; then the memory of the
Gaussians, and the pipeline with every default. Nothing is loaded or trained. The exit status is 1 if a file
or a prior is missing, or if a component is never due.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("pipeline", type=Path, metavar="PIPELINE", help="a YAML file")
        add_changes(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the explanation; return 1 if the pipeline has a fault."""
        from ..inspection.explanation import explained, faults, memory
        from ..pipeline.pipeline import load_pipeline
        from ..plugins.discovery import Plugins

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
        output.print(f"\nmemory, estimated\n  {memory(pipeline)}")
        output.print(f"\nthe pipeline in full\n\n{pipeline.to_yaml()}")
        found = faults(pipeline)
        for fault in found:
            output.print(f"fault: {fault}")
        return FAULT if found else 0


class Plugins(Command):
    """List the components that a pipeline can name."""

    epilog = """\
examples:
  stereogs plugins                 name and purpose of each component
  stereogs plugins dropout         purpose and settings of one
  stereogs plugins --json          everything as JSON, with schemas of settings
  stereogs plugins --check         exit status 1 if a plugin cannot be loaded or two names clash
  stereogs plugins new solid --kind regularizer
                                   write a new package to stereogs-solid

STEREOGS_PLUGINS chooses what is loaded: unset = all, empty = none, or entry names by commas.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--json", action="store_true", help="print JSON")
        parser.add_argument("--check", action="store_true", help="fail if a plugin has a fault")
        parser.set_defaults(action=_list_components)
        actions = parser.add_subparsers(title="verbs", metavar="VERB")
        epilog = "examples:\n  stereogs plugins show dropout\n  stereogs plugins dropout\n"
        show = add_verb(actions, "show", "show purpose and settings of a component", epilog)
        show.add_argument("name", metavar="NAME", help="as a pipeline writes it")
        show.set_defaults(action=_show_component)
        new = add_verb(
            actions, "new", "write a plugin package that installs and trains", NEW_EPILOG
        )
        new.add_argument(
            "name", metavar="NAME", help="of the component, as pipelines will write it"
        )
        new.add_argument("--kind", required=True, metavar="KIND", help="what it is; see below")
        new.add_argument(
            "--into",
            type=Path,
            default=Path(),
            metavar="DIR",
            help="the folder to write the package's folder into (default: this one)",
        )
        new.set_defaults(action=_write_package)

    def run(self, arguments: argparse.Namespace) -> int:
        """List components, describe one, or write a new package."""
        status: int = arguments.action(arguments)
        return status


NEW_EPILOG = """\
kinds:
  scene, initializer, prior, sampler, appearance, regularizer, modifier, densification, opacity,
  perturbation, metric, exporter, report, observer, command

examples:
  stereogs plugins new solid --kind regularizer
  pip install -e stereogs-solid
  stereogs train stereogs-solid/pipeline.yaml
"""


def with_verb(arguments: list[str]) -> list[str]:
    """Return the command line with `plugins NAME` replaced by `plugins show NAME`."""
    if arguments[0] != "plugins" or len(arguments) < 2:
        return arguments
    if arguments[1].startswith("-") or arguments[1] in ("show", "new"):
        return arguments
    return ["plugins", "show", *arguments[1:]]


def _write_package(arguments: argparse.Namespace) -> int:
    from ..plugins.scaffolding import new_plugin

    folder = new_plugin(arguments.name, arguments.kind, arguments.into)
    console().print(f"wrote {folder}; its README.md says what comes next")
    return 0


def _show_component(arguments: argparse.Namespace) -> int:
    """Print the help of every component of that name."""
    from ..inspection.explanation import component_help
    from ..plugins.discovery import Plugins

    console().print(component_help(arguments.name, Plugins()), end="")
    return 0


def _list_components(arguments: argparse.Namespace) -> int:
    """Print all components; return 1 if --check finds a fault."""
    from ..plugins.discovery import Plugins

    plugins = Plugins()
    offers = plugins.all()
    faults = [*plugins.broken.values(), *plugins.conflicts()]
    if arguments.json:
        content = {
            "plugins": [_as_json(offer) for offer in offers],
            "faults": [{"what": f.what, "where": f.where, "fix": f.fix} for f in faults],
        }
        print(json.dumps(content, indent=2))
    else:
        output = console()
        output.print(_table(offers), soft_wrap=False)
        for fault in faults:
            output.print(str(fault))
        if arguments.check and not faults:
            output.print(f"{len(offers)} components, no fault")
    return FAULT if arguments.check and faults else 0


def _table(offers: Sequence[Offer]) -> Table:
    """Return a row for each component, below its section of a pipeline."""
    from rich.table import Table

    from ..inspection.explanation import summary

    table = Table.grid(padding=(0, 2))
    longest = max((len(offer.name) for offer in offers), default=0)
    table.add_column(no_wrap=True, min_width=longest + 2)
    table.add_column()
    section = ""
    for offer in offers:
        if offer.point.section != section:
            section = offer.point.section
            table.add_row(section)
        table.add_row(f"  {offer.name}", summary(offer))
    return table


def _as_json(offer: Offer) -> dict[str, Any]:
    from ..inspection.explanation import summary

    return {
        "name": offer.name,
        "section": offer.point.section,
        "hook": offer.point.hook,
        "plugin": offer.plugin,
        "package": offer.distribution,
        "version": offer.version,
        "summary": summary(offer),
        "settings": offer.settings_type.model_json_schema(),
    }
