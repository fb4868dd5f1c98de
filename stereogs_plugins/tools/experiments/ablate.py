"""Train with parts on and off, and settings varied; one table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from registry import Command, Register, hookimpl

from .carrying_out import add_arguments, carry_out

if TYPE_CHECKING:
    from .planning.description import Description

_EPILOG = """\
examples:
  stereogs ablate demo --toggle dropout,opacity
  stereogs ablate demo --vary modifiers.dropout.rate=0.1,0.3,0.5
  stereogs ablate ablations/parts --scenes llff_fern,llff_flower --seeds 3

On is what the pipeline says. Off: a component is disabled, unless it names what it takes the place of;
so decays of opacity give way to 3DGS's periodic reset. An ablation file may say otherwise.

Runs that are finished are found by their pipeline and not trained again: the same command goes on
where it was stopped. It writes ablation.txt, ablation.csv and index.html.
"""


class Ablate(Command):
    """The verb `ablate`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument(
            "file", type=Path, metavar="FILE", help="a pipeline or an ablation file"
        )
        parser.add_argument(
            "--toggle",
            metavar="A,B",
            help="what to switch on and off: sections or names of components",
        )
        parser.add_argument(
            "--vary",
            action="append",
            default=[],
            metavar="A.B=V,V",
            help="values of a setting; repeat for several settings",
        )
        parser.add_argument(
            "--scenes", metavar="A,B", help="folders in STEREOGS_DATA, or paths (with a slash)"
        )
        parser.add_argument(
            "--seeds", type=int, metavar="N", help="train with so many seeds (default 1)"
        )
        parser.add_argument(
            "--pipeline",
            type=Path,
            metavar="FILE",
            help="in place of an ablation file's own pipeline",
        )
        parser.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="A.B=VALUE",
            help="change a setting of the pipeline, as for train",
        )
        add_arguments(parser, "runs/ablation-<file>")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train what is missing, then write and print the table; 130 after Ctrl-C."""
        from registry.plugins import Plugins

        from .planning.making import make_plan

        description, plugins = _description(arguments), Plugins()
        return carry_out(arguments, make_plan(description, plugins), description.runner, plugins)


def _description(arguments: argparse.Namespace) -> Description:
    from .planning.arguments import with_arguments
    from .planning.description import read_description

    return with_arguments(
        read_description(arguments.file, arguments.pipeline),
        overrides=arguments.set,
        toggles=arguments.toggle,
        vary=arguments.vary,
        scenes=arguments.scenes,
        seeds=arguments.seeds,
    )


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("ablate", Ablate)
