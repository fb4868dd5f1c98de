"""Render a run's test views or a camera path."""

from __future__ import annotations

import argparse

from registry import Command, Register, hookimpl
from registry.commands import add_run, console, open_given
from registry.messages import counted

_EPILOG = """\
examples:
  stereogs render runs/3dgs-fern          images of the test views
  stereogs render runs/3dgs-fern --path   a smooth path through the training views

The path is rendered to a video if the extra `video` is installed (pip install 'stereogs-plugins[video]'),
otherwise to numbered PNG images.
"""


class Render(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--path", action="store_true", help="render a smooth path through the training views"
        )
        parser.add_argument(
            "--frames",
            type=int,
            default=120,
            metavar="N",
            help="number of frames of the path (default 120)",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Render and print where the files are."""
        output = console()
        run = open_given(arguments)
        from registry.runs import RENDERS
        from registry.toolkit.drawing import save_view_pictures, smooth_path, write_video
        from registry.training import one_torch_thread

        folder = run.folder_or_refuse().folder(RENDERS)
        with one_torch_thread():
            if not arguments.path:
                for view in run.scene.test:
                    save_view_pictures(run.rendering(view.camera), view, folder)
                output.print(f"{counted(len(run.scene.test), 'test view')} in {folder}")
                return 0
            cameras = smooth_path([view.camera for view in run.scene.train], arguments.frames)
            frames = (run.rendering(camera).rgb for camera in cameras)
            written, note = write_video(frames, folder / "path")
        output.print(f"{note}: {written}")
        return 0


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("render", Render)
