"""List the components that a pipeline can name."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.command import Command
from .output import add_verb, console

if TYPE_CHECKING:
    from rich.table import Table

    from ..plugins.discovery import Offer

FAULT = 1

_EPILOG = """\
examples:
  stereogs plugins                 a line for each: its name and what it does
  stereogs plugins dropout         what one is for, and its settings
  stereogs plugins --json          all of it for programs, with JSON schemas
  stereogs plugins --check         1 if one cannot be loaded or two names clash
  stereogs plugins new solid --kind regularizer
                                   a package to begin with, in stereogs-solid

STEREOGS_PLUGINS chooses what is loaded: unset = all, empty = none, or entry names by commas.
"""

_NEW_EPILOG = """\
kinds:
  scene, initializer, prior, sampler, appearance, regularizer, modifier, densification, opacity,
  perturbation, metric, exporter, report, observer, command

examples:
  stereogs plugins new solid --kind regularizer
  pip install -e stereogs-solid
  stereogs train stereogs-solid/pipeline.yaml
"""


class Plugins(Command):
    """The verb `plugins`, with `plugins NAME` and `plugins new NAME`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("--json", action="store_true", help="print JSON")
        parser.add_argument("--check", action="store_true", help="fail if a plugin has a fault")
        parser.set_defaults(action=run)
        actions = parser.add_subparsers(title="verbs", metavar="VERB")
        _add_show(actions)
        _add_new(actions)

    def run(self, arguments: argparse.Namespace) -> int:
        """List, describe one, or write a new package."""
        action: Callable[[argparse.Namespace], int] = arguments.action
        return action(arguments)


def with_verb(arguments: list[str]) -> list[str]:
    """The command line with `plugins NAME` written out as `plugins show NAME`."""
    if arguments[0] != "plugins" or len(arguments) < 2:
        return arguments
    if arguments[1].startswith("-") or arguments[1] in ("show", "new"):
        return arguments
    return ["plugins", "show", *arguments[1:]]


def _add_new(actions: Any) -> None:
    parser = add_verb(
        actions, "new", "write a plugin package that installs and trains", _NEW_EPILOG
    )
    parser.add_argument("name", metavar="NAME", help="of the component, as pipelines will write it")
    parser.add_argument("--kind", required=True, metavar="KIND", help="what it is; see below")
    parser.add_argument(
        "--into",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="the folder to write the package's folder into (default: this one)",
    )
    parser.set_defaults(action=run_new)


def run_new(arguments: argparse.Namespace) -> int:
    """Write the package and say what comes next."""
    from ..plugins.scaffolding import new_plugin

    folder = new_plugin(arguments.name, arguments.kind, arguments.into)
    console().print(f"wrote {folder}; its README.md says what comes next")
    return 0


def _add_show(actions: Any) -> None:
    epilog = "examples:\n  stereogs plugins show dropout\n  stereogs plugins dropout\n"
    parser = add_verb(actions, "show", "say what a component is for and what can be set", epilog)
    parser.add_argument("name", metavar="NAME", help="as a pipeline writes it")
    parser.set_defaults(action=run_show)


def run_show(arguments: argparse.Namespace) -> int:
    """Print every component of that name."""
    from ..inspection.component_help import component_help
    from ..plugins.discovery import Plugins

    output = console()
    output.print(component_help(arguments.name, Plugins()), end="")
    return 0


def run(arguments: argparse.Namespace) -> int:
    """List them; 1 if --check finds a fault."""
    from ..plugins.discovery import Plugins

    plugins = Plugins()
    offers = plugins.all()
    faults = [*plugins.broken.values(), *plugins.conflicts()]
    output = console()
    if arguments.json:
        print(
            json.dumps(
                {
                    "plugins": [_as_json(offer) for offer in offers],
                    "faults": [{"what": f.what, "where": f.where, "fix": f.fix} for f in faults],
                },
                indent=2,
            )
        )
    else:
        output.print(_table(offers), soft_wrap=False)
        for fault in faults:
            output.print(str(fault))
        if arguments.check and not faults:
            output.print(f"{len(offers)} components, no fault")
    return FAULT if arguments.check and faults else 0


def _table(offers: Sequence[Offer]) -> Table:
    """What each component does, under the section of a pipeline that it fills."""
    from rich.table import Table

    from ..inspection.component_help import summary

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
    from ..inspection.component_help import summary

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
