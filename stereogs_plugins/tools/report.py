"""Write a page about a finished run."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from registry import Command, Register, RunError, hookimpl
from registry.commands import add_run, console, open_given, print_failures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry.pipeline import Part
    from registry.plugins import Offer, Plugins
    from registry.runs import Run

BESIDE = "beside"
"""The setting of a report that --inline and --beside set."""

_EPILOG = """\
examples:
  stereogs report runs/3dgs-fern
  stereogs report runs/3dgs-fern --beside     large files beside the page

Writes the reports that the run's pipeline names; every installed one if it names none. A page with
all inside can be mailed; one with files beside it opens faster, and holds a scene of any size.
"""


class Report(Command):
    """The verb `report`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        place = parser.add_mutually_exclusive_group()
        place.add_argument(
            "--inline", dest=BESIDE, action="store_false", default=None, help="all inside the page"
        )
        place.add_argument(
            "--beside",
            dest=BESIDE,
            action="store_true",
            default=None,
            help="large data beside the page",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Write, and say where; 1 if a report failed."""
        from registry.plugins import Plugins

        output = console()
        given = open_given(arguments)
        if not given.finished or not given.folder_or_refuse().results():
            raise RunError(
                "the run has not ended: there is nothing to report yet",
                where=str(arguments.run_folder),
                fix=f"stereogs resume {arguments.run_folder}",
            )
        files, failures = given.report(_reports(given, Plugins(), arguments.beside))
        for file in files:
            output.print(f"page  {given.folder_or_refuse().path / file}")
        return print_failures([f.model_dump() for f in failures], arguments.run_folder)


def _reports(run: Run, plugins: Plugins, beside: bool | None) -> Sequence[Part]:
    """The pipeline's reports, or all that are installed, with --inline or --beside.

    Raises:
        RunError: there is none, or none that knows of --inline and --beside.
    """
    from registry.pipeline import build_part, load_pipeline

    items = run.pipeline.items["reports"]
    offers = [o for o in plugins.all() if o.point.section == "reports"]
    wanted = [(item.offer, item.settings.model_dump(mode="json")) for item in items]
    wanted = wanted or [(offer, {}) for offer in offers]
    if not wanted:
        raise RunError(
            "no report is installed",
            where="stereogs report",
            fix="install a plugin that offers one; `stereogs plugins` lists what there is",
        )
    movable = [offer for offer, _ in wanted if _is_movable(offer)]
    if beside is not None and not movable:
        raise RunError(
            "none of the reports can put data inside its page or beside it",
            where="--beside" if beside else "--inline",
            fix="leave the option out",
        )
    entries = []
    for offer, settings in wanted:
        choice = {BESIDE: beside} if beside is not None and offer in movable else {}
        entries.append({"use": offer.name, **settings, **choice})
    asked = load_pipeline(
        run.folder_or_refuse().pipeline, plugins, overrides=[f"reports={json.dumps(entries)}"]
    )
    seed = asked.training.seed
    return [build_part(item, seed, run.model.device) for item in asked.items["reports"]]


def _is_movable(offer: Offer) -> bool:
    return BESIDE in offer.settings_type.model_fields


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("report", Report)
