"""List the components that a pipeline can name."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from registry import RunError

from ...command_line.command import Command
from ...command_line.output import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from registry.discovery import Offer


class ListPlugins(Command):
    epilog = """\
examples:
  stereogs plugins                 name and purpose of each component
  stereogs plugins dropout         purpose and settings of one
  stereogs plugins training        settings of the section `training`
  stereogs plugins --json          everything as JSON, with schemas of settings
  stereogs plugins --check         exit status 1 if a plugin cannot be loaded or two names clash

STEREOGS_PLUGINS chooses what is loaded: unset = all, empty = none, or entry names by commas.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "name", nargs="?", metavar="NAME", help="show this component, or `training`, only"
        )
        parser.add_argument("--json", action="store_true", help="print JSON")
        parser.add_argument("--check", action="store_true", help="fail if a plugin has a fault")

    def run(self, arguments: argparse.Namespace) -> int:
        """List components, or describe one."""
        if arguments.name is None:
            return _list_components(arguments)
        if arguments.json or arguments.check:
            raise RunError(
                "--json and --check are about all components, not one",
                where="the command line",
                fix=f"remove the option, or {arguments.name!r}",
            )
        from registry.discovery import Plugins

        from .summaries import component_help

        console().print(component_help(arguments.name, Plugins()), end="")
        return 0


def _list_components(arguments: argparse.Namespace) -> int:
    """Print all components; return 1 if --check finds a fault."""
    from registry.discovery import Plugins

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
    return 1 if arguments.check and faults else 0


def _table(offers: Sequence[Offer]) -> Table:
    """Return a row for each component, below its section of a pipeline."""
    from rich.table import Table

    from .summaries import summary

    table = Table.grid(padding=(0, 2))
    longest = max((len(offer.use) for offer in offers), default=0)
    table.add_column(no_wrap=True, min_width=longest + 2)
    table.add_column()
    section = ""
    for offer in offers:
        if offer.point.section != section:
            section = offer.point.section
            table.add_row(section)
        table.add_row(f"  {offer.use}", summary(offer))
    return table


def _as_json(offer: Offer) -> dict[str, Any]:
    from .summaries import summary

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
