"""Show what a scene loader finds in a folder of data, and whether it can be trained."""

from __future__ import annotations

import argparse
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.messages.suggestions import counted
from registry.toolkit.cache.remote import url_of
from registry.toolkit.progress.display import showing

from ...command_line.arguments import add_device
from ...command_line.command import Command
from ...command_line.output import console
from .option import add_photo_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from registry import Scene

_EPILOG = """\
examples:
  stereogs check my-photos            a folder with only photographs
  stereogs check /data/llff_fern --set downsample=8
  stereogs check /data/scan24 --format dtu --set train_views=6
  stereogs check pipeline.yaml        the scene of a pipeline

The content of the folder determines the loader; `stereogs plugins` lists the loaders and their settings.
The image shows all views (training views framed in orange, test views in blue) and the cameras from
above, with the sparse points.
"""


class Check(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "data", type=Path, metavar="DATA", help="a folder, a video or a pipeline"
        )
        parser.add_argument(
            "--format", metavar="NAME", help="the scene loader (default: by the folder's content)"
        )
        parser.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="change a setting of the loader",
        )
        add_photo_options(parser)
        parser.add_argument(
            "--out",
            type=Path,
            default=Path("check.png"),
            metavar="PATH",
            help="the image to write, or a folder for it (default: check.png)",
        )
        parser.add_argument(
            "--details", action="store_true", help="print everything that is known about the scene"
        )
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Load the scene, print its properties, write the image, say if it can be trained."""
        picture = arguments.out / "check.png" if arguments.out.is_dir() else arguments.out
        _check_writable(picture)
        output = console()
        with showing(output):
            from registry.discovery import Plugins

            from ...scene_source import find_loader

            found = find_loader(
                arguments.data, Plugins(), format_name=arguments.format, changes=arguments.set
            )
            from core_rasterizer import open_device
            from registry.calls.process_state import one_torch_thread
            from registry.toolkit.drawing import DRAWN, save_png
            from registry.training.scene_facts import warnings

            from .facts import MAIN, facts
            from .pose_fit import pose_fault
            from .scene_picture import scene_picture

            device = open_device(arguments.device)
            with one_torch_thread():
                scene = found.load(device)
        offer = found.item.offer
        output.print(f"{scene.name}, read by the {offer.point.title} {offer.name}")
        known = facts(scene)
        if arguments.details:
            known += [(fact.name.replace("_", " "), str(fact)) for fact in scene.facts]
        _print_columns(output, known if arguments.details else known[:MAIN])
        found_faults = warnings(scene)
        if not _connected(scene):  # loaders that find cameras check them
            fault = pose_fault((*scene.train, *scene.test))
            found_faults = [*([fault] if fault else []), *found_faults]
        for text in found_faults:
            output.print(f"warning: {text}")
        save_png(scene_picture(scene), picture, {DRAWN: "stereogs check"})
        output.print(f"image  {picture}: all views, and the cameras from above")
        output.print(f"{_verdict(scene, len(found_faults))}\n  {_training_command(arguments)}")
        return 0


def _connected(scene: Scene) -> list[str]:
    """Return the fact `connected`, for example "5 of 6", of loaders that find cameras; else nothing."""
    return [str(fact) for fact in scene.facts if fact.name == "connected"]


def _verdict(scene: Scene, warnings: int) -> str:
    """Return how many photographs can be used."""
    connected = _connected(scene)
    what = f"{counted(len(scene.train) + len(scene.test), 'photograph')} with cameras"
    if connected:
        what = f"{connected[0]} photographs connect"
    return f"{what}; ready" + (f", with {counted(warnings, 'warning')}" if warnings else "") + ":"


def _training_command(arguments: argparse.Namespace) -> str:
    changes = [f"scene.use={arguments.format}"] if arguments.format else []
    changes += [f"scene.{text.removeprefix('scene.')}" for text in arguments.set]
    options = [part for text in changes for part in ("--set", text)]
    return shlex.join(
        ["stereogs", "train", url_of(arguments.data) or str(arguments.data), *options]
    )


def _check_writable(path: Path) -> None:
    """Check the path of the image before the scene is loaded, which may take minutes."""
    if path.suffix.lower() != ".png" or path.is_dir() or not path.absolute().parent.is_dir():
        raise RunError(
            "the image must be a .png file in an existing folder",
            where=f"--out {path}",
            fix="for example --out check.png",
        )
    if not os.access(path.absolute().parent, os.W_OK):
        raise RunError(
            f"the folder {path.absolute().parent} cannot be written",
            where=f"--out {path}",
            fix="choose another --out",
        )


def _print_columns(output: Console, rows: Sequence[tuple[str, str]]) -> None:
    width = max((len(label) for label, _ in rows), default=0)
    for label, text in rows:
        output.print(f"  {label:<{width}}  {text}")
