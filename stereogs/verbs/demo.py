"""Train on three views and score other views."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.toolkit.progress.display import showing

from ..command_line.arguments import add_device
from ..command_line.command import Command
from ..command_line.output import conclude, console

if TYPE_CHECKING:
    from rich.console import Console

    from registry.runs.folder import RunFolder

DATA = "STEREOGS_DATA"

_EPILOG = """\
examples:
  stereogs demo
  STEREOGS_DATA=/data stereogs demo     photographs of a scene in /data, not a synthetic room

Trains for half a minute on two processor cores and scores test views. Writes report.html, a page about
the run, and demo.png, a test view with its render and depth, into the run folder.
"""


class Demo(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--out", type=Path, metavar="DIR", help="the run folder (default: a new one in runs)"
        )
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Train the pipeline `demo` and print the results."""
        import shutil

        output = console()
        with showing(output):
            from registry.discovery import Plugins
            from registry.pipeline.pipeline import load_pipeline
            from registry.runs.folder import in_runs
            from registry.runs.results import RENDERS
            from registry.system.files import replacing
            from registry.toolkit.drawing.pictures import COMPARISONS

            from ..session import train

            scene = photographs()
            overrides = [] if scene is None else [f"scene={json.dumps(scene, ensure_ascii=False)}"]
            pipeline = load_pipeline(Path("demo"), Plugins(), overrides=overrides)
            what = "the built-in room" if scene is None else f"photographs in {scene['path']}"
            output.print(
                f"demo: a scene from three views of {what}; half a minute on two idle cores, a few "
                "seconds more the first time"
            )
            run = train(
                pipeline, out=arguments.out or in_runs, progress=output, device=arguments.device
            )
        folder = run.folder_or_refuse()
        if run.finished:
            comparison = min((folder.path / RENDERS / COMPARISONS).iterdir())
            with replacing(folder.path / "demo.png") as temporary:
                shutil.copyfile(comparison, temporary)
        status = conclude(run, output)
        if run.finished:
            _print_next_steps(folder, output)
        return status


def _print_next_steps(folder: RunFolder, output: Console) -> None:
    """Print what to look at and the commands for the user's own photographs."""
    output.print(
        f"picture   {folder.path / 'demo.png'}: a new view, its render and its depth\n\nnext"
    )
    for file in folder.results()["reports"]:
        output.print(f"  open {folder.path / file} in a browser to turn the scene")
    output.print(
        "  stereogs check FOLDER   with a folder of your own photographs, three to eighty\n"
        "  stereogs train FOLDER"
    )


def photographs() -> dict[str, Any] | None:
    """Return the section `scene` of a pipeline for a scene in STEREOGS_DATA; None if there is none.

    STEREOGS_DATA is the folder of an LLFF scene or a folder of scenes; the first by name with photographs at
    1/8 size is used, as larger ones would train for longer.
    """
    root = os.environ.get(DATA)
    if not root or not Path(root).is_dir():
        return None
    from registry.pipeline.settings_check import escape_variables

    for folder in (Path(root), *sorted(path for path in Path(root).iterdir() if path.is_dir())):
        if (folder / "poses_bounds.npy").is_file() and (folder / "images_8").is_dir():
            inside = folder.relative_to(root).as_posix()
            path = f"${{{DATA}}}" + ("" if inside == "." else f"/{escape_variables(inside)}")
            return {"use": "llff", "path": path, "train_views": 3}
    return None
