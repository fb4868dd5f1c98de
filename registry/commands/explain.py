"""Say what a pipeline will do, and when."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..contract.command import Command
from .output import console

_EPILOG = """\
examples:
  stereogs explain pipelines/3dgs.yaml
  stereogs explain pipelines/3dgs.yaml --set training.iterations=5000

Stage by stage: what is at work and from which package, in which iterations, what it is given, which files
and priors it needs, and what the Gaussians take in memory. Then the pipeline with every default written
out. Nothing is loaded or trained. Exit status 1 if a file or a prior is missing, or something is never due.
"""

FAULT = 1


class Explain(Command):
    """The verb `explain`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("pipeline", type=Path, metavar="PIPELINE", help="a YAML file")
        parser.add_argument(
            "--set", action="append", default=[], metavar="A.B=VALUE", help="change a setting"
        )
        parser.add_argument(
            "--disable", action="append", default=[], metavar="NAME", help="switch a component off"
        )

    def run(self, arguments: argparse.Namespace) -> int:
        """Print it; 1 if something in it is known to go wrong."""
        from ..inspection.explanation import explained, faults, memory
        from ..pipeline.pipeline import load_pipeline
        from ..plugins.discovery import Plugins

        pipeline = load_pipeline(
            arguments.pipeline, Plugins(), overrides=arguments.set, disabled=arguments.disable
        )
        output = console()
        training = pipeline.training
        each = pipeline.iterations_per_view
        length = f"{training.iterations} iterations" + (
            f", {each} per training view" if each else ""
        )
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
