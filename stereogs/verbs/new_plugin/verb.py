"""Write a plugin package that installs and trains."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...command_line.command import Command
from ...command_line.output import console


class NewPlugin(Command):
    epilog = """\
kinds:
  scene, initializer, prior, sampler, appearance, regularizer, modifier, densification, opacity,
  perturbation, metric, exporter, report, observer, command

examples:
  stereogs new-plugin solid --kind regularizer
  pip install -e stereogs-solid
  stereogs train stereogs-solid/pipeline.yaml
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name", metavar="NAME", help="of the component or verb")
        parser.add_argument("--kind", required=True, metavar="KIND", help="what it is; see below")
        text = "the folder to write the package's folder into (default: this one)"
        parser.add_argument("--into", type=Path, default=Path(), metavar="DIR", help=text)

    def run(self, arguments: argparse.Namespace) -> int:
        from .package_files import new_plugin

        folder = new_plugin(arguments.name, arguments.kind, arguments.into)
        console().print(f"wrote {folder}; its README.md says what comes next")
        return 0
