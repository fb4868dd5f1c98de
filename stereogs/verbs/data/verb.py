"""List the data sets of the protocols, verify a copy, or write what a protocol makes of it."""

from __future__ import annotations

import argparse
from pathlib import Path

from registry.toolkit.cache.remote import on_this_machine

from ...command_line.command import Command
from ...command_line.output import console

_EPILOG = """\
examples:
  stereogs data                                    the files of each protocol, and where they are published
  stereogs data check llff-3 /data/llff_fern       compare a copy with what was published; print the split
  stereogs data build llff-3 /data/llff_fern --out fern
                                                   photographs at the protocol's size, masks, cameras, split

Nothing is downloaded. `check` ends with 1 if files are missing or differ. `build` writes a COLMAP model or
nerfstudio's transforms.json; where images_8 is missing it makes it from images, as means of 8x8 pixels.
"""


class Data(Command):
    epilog = _EPILOG
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the actions."""
        actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action")
        for name, summary in (("check", "verify a copy"), ("build", "write the protocol's views")):
            action = actions.add_parser(
                name, help=summary, epilog=_EPILOG, formatter_class=parser.formatter_class
            )
            action.add_argument("protocol", metavar="PROTOCOL", help="for example llff-3")
            action.add_argument(
                "folder", type=on_this_machine, metavar="FOLDER", help="of one scene"
            )
            if name == "build":
                action.add_argument(
                    "--out", type=on_this_machine, required=True, metavar="DIR", help="a new folder"
                )
                action.add_argument(
                    "--format",
                    choices=("colmap", "transforms"),
                    default="colmap",
                    help="the layout (default: colmap)",
                )

    def run(self, arguments: argparse.Namespace) -> int:
        """Do the action; without one list the data sets."""
        if arguments.action is None:
            _list_data_sets()
            return 0
        if arguments.action == "check":
            return _check(arguments.protocol, arguments.folder)
        from .building import build

        written = build(arguments.protocol, arguments.folder, arguments.out, arguments.format)
        console().print(f"wrote {len(written)} files in {arguments.out}")
        return 0


def _list_data_sets() -> None:
    from registry.pipeline.protocols import load_protocol

    from .verification import data_sets

    output = console()
    for data_set in data_sets():
        verifiable = ", ".join(data_set.scenes)
        output.print(f"{data_set.name}: {', '.join(data_set.protocols)}")
        output.print(f"  scenes      {', '.join(load_protocol(data_set.protocols[0]).scenes)}")
        output.print(f"  each with   {', '.join(data_set.files)}")
        output.print(f"  published   {data_set.published}")
        output.print(f"  verifiable  {verifiable}\n")


def _check(protocol: str, folder: Path) -> int:
    from ...protocol_scene import pipeline_of
    from ...session import load_scene
    from .verification import verify

    output, found = console(), list(verify(protocol, folder))
    for finding in found:
        output.print(f"{finding.part:<12} {finding.state}")
        if finding.consequence:
            output.print(f"  {finding.consequence}")
    if not any(finding.state == "missing" for finding in found):
        scene = load_scene(pipeline_of(protocol, folder))
        camera = scene.train[0].camera
        output.print(f"read as      {camera.width}x{camera.height} pixels")
        for kind, views in (("train", scene.train), ("test", scene.test)):
            output.print(f"{kind:<12} {', '.join(view.name for view in views)}")
    return int(any(finding.consequence for finding in found))
