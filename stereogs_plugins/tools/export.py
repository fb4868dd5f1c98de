"""Export a run to other file formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from registry import Command, Register, hookimpl
from registry.commands import add_run, console, open_given

MOST_LINES = 3
"""Largest number of files per folder that are listed one by one."""

_EPILOG = """\
examples:
  stereogs export runs/3dgs-fern --format gltf
  stereogs export runs/3dgs-fern --format video --set frames=300 --out films
  stereogs export runs/weightfree-fern --format spz --without margin,back_layer
  stereogs export runs/weightfree-fern --format ply --min-confidence 0.5

The format is the name of an exporter: `stereogs plugins` lists them, `stereogs plugins NAME` describes one
and its settings. --without leaves out Gaussians that descend from guessed initial points;
initialization/facts.json in the run folder lists the kinds of points (points_by_kind).
"""


class Export(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--format", required=True, metavar="NAME", help="the name of an exporter"
        )
        parser.add_argument(
            "--out",
            type=Path,
            metavar="DIR",
            help="the folder to write (default: exports in the run folder)",
        )
        parser.add_argument(
            "--without",
            type=_names,
            default=(),
            metavar="A,B",
            help="leave out the Gaussians of these kinds of initial points",
        )
        parser.add_argument(
            "--min-confidence",
            type=_share,
            metavar="C",
            help="leave out Gaussians of less confidence, 0 to 1; PLY and glTF hold the values of the others",
        )
        parser.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="change a setting of the exporter",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Export and print the written files."""
        output = console()
        from registry.session import export, find_exporter

        find_exporter(arguments.format, arguments.set)  # fails before the scene is loaded
        opened = open_given(arguments)
        written = export(
            opened,
            arguments.format,
            arguments.out,
            changes=arguments.set,
            without=arguments.without,
            min_confidence=arguments.min_confidence,
        )
        for folder in dict.fromkeys(path.parent for path in written):
            inside = [path for path in written if path.parent == folder]
            if len(inside) > MOST_LINES:
                output.print(f"exported  {len(inside)} files in {folder}")
            else:
                output.print(*(f"exported  {path}" for path in inside), sep="\n")
        return 0


def _names(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in text.split(","))))


def _share(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("export", Export)
