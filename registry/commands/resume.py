"""Continue a run that was stopped."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import monotonic

from ..contract.command import Command, TrainRequest
from ..plugins.commands import train_options
from .output import add_accept_changed_inputs, add_device, console
from .run_options import add_run_options, given_options, running
from .train import conclude

_EPILOG = """\
examples:
  stereogs resume runs/3dgs-fern

Continues from the newest intact checkpoint, to the same result as if the run had never stopped: after Ctrl-C,
a kill, a crash or a full disk. A finished run is scored and exported again.
"""


class Resume(Command):
    """The verb `resume`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments, and those of train options."""
        parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
        add_accept_changed_inputs(parser)
        add_device(parser)
        add_run_options(parser, "resume")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train to the end; exit status as for `train`."""
        begin = monotonic()
        from ..calls.watchdog import WATCHDOG
        from ..session import resume

        output = console()
        request = TrainRequest(arguments, begin)
        with (
            WATCHDOG.ending(arguments.hang_after),
            running(train_options("resume"), request, given_options(arguments, output)) as options,
        ):
            return conclude(resume(arguments.run_folder, options), output)
