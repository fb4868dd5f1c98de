"""`stereogs plugins`: what a pipeline can name; `stereogs plugins new`: a package to begin with."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .output import Verbs, add_verb, console

if TYPE_CHECKING:
    from rich.table import Table

    from ..plugins.discovery import Offer

FAULT = 1

_EPILOG = """\
examples:
  stereogs plugins                 a table: name, hook point, package, settings and their defaults
  stereogs plugins --json          the same for programs, with a JSON schema of the settings
  stereogs plugins --check         exit status 1 if a plugin cannot be loaded or two names clash
  stereogs plugins new solid --kind regularizer     a package to begin with, in stereogs-solid

STEREOGS_PLUGINS chooses what is loaded: unset = all, empty = none, or entry names by commas.
"""

_NEW_EPILOG = """\
kinds:
  scene, initializer, prior, sampler, appearance, regularizer, modifier, densification, opacity,
  perturbation, metric, exporter, report

examples:
  stereogs plugins new solid --kind regularizer
  pip install -e stereogs-solid
  stereogs train stereogs-solid/pipeline.yaml
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "plugins", "list what a pipeline can name", _EPILOG)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--check", action="store_true", help="fail if a plugin has a fault")
    parser.set_defaults(run=run)
    _add_new(parser.add_subparsers(title="verbs", metavar="VERB"))


def _add_new(verbs: Verbs) -> None:
    parser = add_verb(verbs, "new", "write a plugin package that installs and trains", _NEW_EPILOG)
    parser.add_argument("name", metavar="NAME", help="of the component, as pipelines will write it")
    parser.add_argument("--kind", required=True, metavar="KIND", help="what it is; see below")
    parser.add_argument(
        "--into",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="the folder to write the package's folder into (default: this one)",
    )
    parser.set_defaults(run=run_new)


def run_new(arguments: argparse.Namespace) -> int:
    """Write the package and say what comes next."""
    from ..plugins.scaffolding import new_plugin

    folder = new_plugin(arguments.name, arguments.kind, arguments.into)
    console().print(f"wrote {folder}; its README.md says what comes next")
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
    from rich.table import Table

    table = Table()
    for heading in ("section", "name", "package", "settings"):
        table.add_column(heading, overflow="fold")
    for offer in offers:
        table.add_row(
            offer.point.section,
            offer.name,
            f"{offer.distribution} {offer.version}",
            "\n".join(_settings(offer)),
        )
    return table


def _settings(offer: Offer) -> list[str]:
    """`name=default`, or the bare name where a pipeline must give a value."""
    return [
        name
        if field.is_required()
        else f"{name}={json.dumps(field.get_default(call_default_factory=True), default=str)}"
        for name, field in offer.settings_type.model_fields.items()
    ]


def _as_json(offer: Offer) -> dict[str, Any]:
    return {
        "name": offer.name,
        "section": offer.point.section,
        "hook": offer.point.hook,
        "plugin": offer.plugin,
        "package": offer.distribution,
        "version": offer.version,
        "summary": (offer.component.__doc__ or "").strip().partition("\n")[0],
        "settings": offer.settings_type.model_json_schema(),
    }
