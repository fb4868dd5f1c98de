"""Train on three views and score unseen ones."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry import Command, Register, hookimpl
from registry.commands import add_device, conclude, console

if TYPE_CHECKING:
    from registry.plugins import Plugins

DATA = "STEREOGS_DATA"
PIPELINE = "demo"
"""The ready pipeline that is run."""

_EPILOG = """\
examples:
  stereogs demo
  STEREOGS_DATA=/data stereogs demo     photographs of a scene in /data, not a drawn room

It trains for half a minute on two processor cores, scores views that it has not seen, and writes into
the run folder report.html, a page about the run, and demo.png: truth, render and depth of an unseen
view, side by side.
"""


class Demo(Command):
    """The verb `demo`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument(
            "--out", type=Path, metavar="DIR", help="the run folder (default: in runs)"
        )
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Train the demo's pipeline and show what came out."""
        import shutil

        from registry.pipeline import load_pipeline
        from registry.plugins import Plugins
        from registry.runs import RENDERS, in_runs
        from registry.session import train
        from registry.system import replacing
        from registry.toolkit.drawing import COMPARISONS

        output = console()
        plugins = Plugins()
        pipeline = load_pipeline(Path(PIPELINE), plugins, overrides=_scene(plugins))
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
            output.print(f"truth, render and depth of an unseen view: {folder.path / 'demo.png'}")
        return status


def photographs(plugins: Plugins) -> dict[str, Any] | None:
    """The scene in STEREOGS_DATA that a loader would show, as a pipeline writes it; None without one.

    The variable names either a scene's own folder or one that holds scenes, of which the first by name
    is taken that a loader recognizes and has settings for.
    """
    root = os.environ.get(DATA)
    if not root or not Path(root).is_dir():
        return None
    from registry.pipeline import escape_variables
    from registry.plugins import scene_loaders

    loaders = scene_loaders(plugins)
    for folder in (Path(root), *sorted(path for path in Path(root).iterdir() if path.is_dir())):
        for offer, loader in loaders:
            settings = loader.demo_settings(folder) if loader.recognizes(folder) else None
            if settings is not None:
                inside = folder.relative_to(root).as_posix()
                path = f"${{{DATA}}}" + ("" if inside == "." else f"/{escape_variables(inside)}")
                return {"use": offer.name, "path": path, **settings}
    return None


def _scene(plugins: Plugins) -> list[str]:
    """The override that puts photographs in place of the drawn room, if there are any."""
    scene = photographs(plugins)
    return [] if scene is None else [f"scene={json.dumps(scene)}"]


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("demo", Demo)
