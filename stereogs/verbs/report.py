"""Write the reports of a finished run."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import TYPE_CHECKING

from registry import RunError
from registry.toolkit.progress.display import showing

from ..command_line.arguments import add_run, open_given
from ..command_line.command import Command
from ..command_line.output import console, report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry.discovery import Plugins
    from registry.pipeline.parts import Part
    from registry.runs.run import Run

BESIDE = "beside"
"""The setting of reports for --inline and --beside."""

_EPILOG = """\
examples:
  stereogs report runs/3dgs-fern
  stereogs report runs/3dgs-fern --beside     large files next to the page

Writes the reports of the run's pipeline, or all installed reports if it has none. A page that includes all
data can be sent by mail; a page with files next to it opens faster and can show a scene of any size.
"""


class Report(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        place = parser.add_mutually_exclusive_group()
        for option, beside, text in (
            ("--inline", False, "include all data in the page"),
            ("--beside", True, "write large data to files next to the page"),
        ):
            place.add_argument(option, dest=BESIDE, action="store_const", const=beside, help=text)
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Write the reports and print their paths; return 1 if a report failed."""
        from registry.discovery import Plugins

        with showing(console()):
            given = open_given(arguments)
            folder = given.folder_or_refuse()
            if not given.finished or not folder.results():
                raise RunError(
                    "the run has not finished, so it has no report yet",
                    where=folder.shown(),
                    fix=f"stereogs resume {folder.shown()}",
                )
            return report(given, folder, _reports(given, Plugins(), arguments.beside))


def _reports(run: Run, plugins: Plugins, beside: bool | None) -> Sequence[Part]:
    """Build the pipeline's reports, or all installed ones, with --inline or --beside applied.

    Raises:
        RunError: there is none, or none supports --inline and --beside.
    """
    from registry.pipeline.parts import build_part
    from registry.pipeline.pipeline import load_pipeline

    items = run.pipeline.items["reports"]
    if not items:
        names = [offer.name for offer in plugins.all() if offer.point.section == "reports"]
        change = f"reports={json.dumps(names, ensure_ascii=False)}"
        pipeline = load_pipeline(
            run.folder_or_refuse().pipeline, plugins, overrides=[change], needed=()
        )
        items = pipeline.items["reports"]
    if not items:
        raise RunError(
            "no report is installed",
            where="stereogs report",
            fix="install a plugin that offers one; `stereogs plugins` lists the installed components",
        )
    if beside is not None:
        supporting = [item for item in items if BESIDE in type(item.settings).model_fields]
        if not supporting:
            raise RunError(
                "none of the reports supports --inline and --beside",
                where="--beside" if beside else "--inline",
                fix="remove the option",
            )
        for item in supporting:
            changed = replace(item, settings=item.settings.model_copy(update={BESIDE: beside}))
            items = tuple(changed if other is item else other for other in items)
    seed = run.pipeline.training.seed
    return [build_part(item, seed, run.engine_model.engine) for item in items]
