"""Train with parts on and off and settings varied; write one table."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..command_line.command import Command
from .run_plan import add_arguments, run_plan

_EPILOG = """\
examples:
  stereogs ablate demo --toggle dropout,opacity
  stereogs ablate demo --vary modifiers.dropout.rate=0.1,0.3,0.5
  stereogs ablate ablations/parts --scenes llff_fern,llff_flower --seeds 3

"On" means as the pipeline specifies. "Off" disables a component or, if the component names a baseline,
replaces it with the baseline: decays of opacity are replaced with the periodic reset of 3DGS. An ablation
file can set another replacement.

Finished runs are recognized by their pipeline and not trained again, so the same command continues an
interrupted ablation. Writes ablation.txt, ablation.tex, ablation.csv,
ablation_means.csv and index.html.
"""


class Ablate(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "file", type=Path, metavar="FILE", help="a pipeline or an ablation file"
        )
        parser.add_argument(
            "--toggle", metavar="A,B", help="sections or names of components to switch on and off"
        )
        parser.add_argument(
            "--vary",
            action="append",
            default=[],
            metavar="A.B=V,V",
            help="values of a setting; repeat for several settings",
        )
        parser.add_argument(
            "--scenes", metavar="A,B", help="folders in STEREOGS_DATA, or paths with a slash"
        )
        parser.add_argument("--seeds", type=int, metavar="N", help="number of seeds (default 1)")
        parser.add_argument(
            "--pipeline",
            type=Path,
            metavar="FILE",
            help="use this pipeline instead of the one in the ablation file",
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
        from registry.discovery import Plugins

        from .planning.description import read_description, with_arguments
        from .planning.making import make_plan

        description = with_arguments(
            read_description(arguments.file, arguments.pipeline),
            overrides=arguments.set,
            toggles=arguments.toggle,
            vary=arguments.vary,
            scenes=arguments.scenes,
            seeds=arguments.seeds,
        )
        plugins = Plugins()
        return run_plan(arguments, make_plan(description, plugins), description.runner, plugins)
