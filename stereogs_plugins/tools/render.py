"""Render a run's test views or a camera path."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from registry import Command, Register, hookimpl
from registry.commands import add_run, console, open_given
from registry.messages import counted

if TYPE_CHECKING:
    from pathlib import Path

    from registry.confidence import Confidence
    from registry.runs import Run

_EPILOG = """\
examples:
  stereogs render runs/3dgs-fern          images of the test views
  stereogs render runs/3dgs-fern --path   a smooth path through the training views
  stereogs render runs/3dgs-fern --confidence          what is guessed is pale and hatched
  stereogs render runs/3dgs-fern --confidence fisher   by another estimator; `stereogs plugins` lists them

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
        parser.add_argument(
            "--confidence",
            nargs="?",
            const="calibrated",
            metavar="ESTIMATOR",
            help="fade and hatch what is guessed; also draw the confidence of the test views",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Render and print where the files are."""
        output = console()
        run = open_given(arguments)
        from registry.runs import RENDERS
        from registry.toolkit.drawing import hatched, save_view_pictures, smooth_path, write_video
        from registry.training import one_torch_thread

        folder = run.folder_or_refuse().folder(RENDERS)
        confidence = run.confidence(arguments.confidence) if arguments.confidence else None
        with one_torch_thread():
            if not arguments.path:
                for view in run.scene.test:
                    save_view_pictures(run.rendering(view.camera), view, folder)
                output.print(f"{counted(len(run.scene.test), 'test view')} in {folder}")
                if confidence is not None:
                    place, share = _draw(run, confidence, folder)
                    output.print(f"sure of {share:.0%} of the test views' pixels; see {place}")
                return 0
            cameras = smooth_path([view.camera for view in run.scene.train], arguments.frames)
            frames = (run.rendering(camera).rgb for camera in cameras)
            if confidence is not None:
                frames = (hatched(run.rendering(one).rgb, confidence.of(one)) for one in cameras)
            written, note = write_video(frames, folder / "path")
        output.print(f"{note}: {written}")
        return 0


def _draw(run: Run, confidence: Confidence, folder: Path) -> tuple[Path, float]:
    """Write each test view's hatched render and its confidence; return where, and the sure share."""
    from registry.toolkit.drawing import GUESSED, hatched, save_png, with_scale

    place, shares = folder / "confidence", []
    place.mkdir(exist_ok=True)
    for view in run.scene.test:
        its = confidence.of(view.camera)
        shares.append(float((its >= GUESSED).double().mean()))
        save_png(hatched(run.rendering(view.camera).rgb, its), place / f"{view.name}.png")
        save_png(with_scale(its), place / f"{view.name}-scale.png")
    return place, sum(shares) / max(1, len(shares))


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("render", Render)
