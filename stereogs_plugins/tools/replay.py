"""Repeat a failed iteration."""

from __future__ import annotations

import argparse
from pathlib import Path

from registry import Command, Register, hookimpl
from registry.commands import add_accept_changed_inputs, add_device, console

_EPILOG = """\
examples:
  stereogs replay runs/3dgs-fern/failures/iteration-0000021
  STEREOGS_TRACE=1 stereogs replay runs/3dgs-fern/failures/iteration-0000021

A run whose iteration fails saves the state before it. This command repeats the iteration: it reproduces
the error, or succeeds if the cause has been fixed.
"""


class Replay(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "failure",
            type=Path,
            metavar="FAILURE",
            help="a folder in RUN/failures, or a file in it",
        )
        add_accept_changed_inputs(parser)
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Repeat the iteration; return 0 if it succeeds."""
        from core_rasterizer import open_device
        from registry.plugins import Plugins
        from registry.runs import repeat_failure
        from registry.training import one_torch_thread

        with one_torch_thread():
            failure = repeat_failure(
                arguments.failure,
                plugins=Plugins(),
                device=open_device(arguments.device),
                accept_changed_inputs=arguments.accept_changed_inputs,
            )
        console().print(
            f"iteration {failure.iteration} succeeds now; it had failed with: {failure.what}"
        )
        return 0


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("replay", Replay)
