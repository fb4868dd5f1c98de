"""Write a plugin package that installs and trains."""

from __future__ import annotations

import argparse
from pathlib import Path

from registry.toolkit.cache.remote import on_this_machine

from ...command_line.command import Command
from ...command_line.output import console


class NewPlugin(Command):
    epilog = """\
kinds:
  scene, initializer, prior, sampler, appearance, regularizer, modifier, densification, opacity,
  perturbation, metric, exporter, report, observer, command

capabilities of a prior:
  stereo_disparity, monocular_depth, multi_view_depth, posed_depth, normals, masks, gaussians,
  optical_flow, matches, own

examples:
  stereogs new-plugin solid --kind regularizer
  stereogs new-plugin walls --kind prior --capability posed_depth
  pip install -e stereogs-solid
  stereogs train stereogs-solid/pipeline.yaml
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name", metavar="NAME", help="of the component or verb")
        parser.add_argument("--kind", required=True, metavar="KIND", help="what it is; see below")
        text = "what a prior estimates (default: stereo_disparity)"
        parser.add_argument("--capability", metavar="NAME", help=text)
        text = "the folder to write the package's folder into (default: this one)"
        parser.add_argument(
            "--into", type=on_this_machine, default=Path(), metavar="DIR", help=text
        )

    def run(self, arguments: argparse.Namespace) -> int:
        from .package_files import new_plugin

        folder = new_plugin(arguments.name, arguments.kind, arguments.into, arguments.capability)
        console().print(f"wrote {folder}; its README.md says what comes next")
        return 0
