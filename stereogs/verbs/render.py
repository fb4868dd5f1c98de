"""Render a run's test views or a camera path; without test views, the training views."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from registry import RunError
from registry.messages.suggestions import counted

from ..command_line.arguments import add_run, open_given
from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from registry import View
    from registry.confidence import Confidence
    from registry.runs.run import Run

FRAMES = 120
"""Number of frames of the path by default."""
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
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--path", action="store_true", help="render a smooth path through the training views"
        )
        parser.add_argument(
            "--frames",
            type=int,
            metavar="N",
            help=f"number of frames of the path (default {FRAMES})",
        )
        parser.add_argument(
            "--confidence",
            nargs="?",
            const="calibrated",
            metavar="ESTIMATOR",
            help="fade and hatch what is guessed; also draw the confidence of the views",
        )
        add_run(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Render and print where the files are."""
        if arguments.frames is not None and not arguments.path:
            fix = "add --path, or remove --frames"
            raise RunError("only a path has frames", where="--frames", fix=fix)
        output = console()
        run = open_given(arguments, photographs=False)
        from registry.runs.results import RENDERS
        from registry.toolkit.drawing import smooth_path, write_video
        from registry.toolkit.drawing.pictures import save_view_pictures

        from ..confidence_picture import hatched

        kept, scene = run.folder_or_refuse(), run.scene
        folder = kept.folder(RENDERS)
        confidence = run.confidence(arguments.confidence) if arguments.confidence else None
        if not arguments.path:
            split, views = ("test", scene.test) if scene.test else ("training", scene.train)
            for view in views:
                rendering = run.rendering(view.camera)
                save_view_pictures(rendering, view, folder, compared=run.photographs)
            output.print(f"{counted(len(views), f'{split} view')} in {folder}")
            if confidence is not None:
                place, share = _draw(run, views, arguments.confidence, confidence, folder)
                output.print(
                    f"sure of {share:.0%} of the {split} views' pixels; pictures in {place}; "
                    f"`stereogs report {kept.shown()}` puts them on the page"
                )
            return 0
        count = FRAMES if arguments.frames is None else arguments.frames
        cameras = smooth_path([view.camera for view in scene.train], count)
        frames = (run.rendering(camera).rgb for camera in cameras)
        if confidence is not None:
            frames = (hatched(run.rendering(c).rgb, confidence.of(c)) for c in cameras)
        written, note = write_video(frames, folder / "path")
        output.print(f"{note}: {written}")
        return 0


def _draw(
    run: Run, views: Sequence[View], name: str, confidence: Confidence, folder: Path
) -> tuple[Path, float]:
    """Write pictures and numbers of each view's confidence; return where, and the sure share."""
    from registry.system.files import write_text
    from registry.toolkit.drawing import save_png
    from registry.toolkit.images import decibels, predicted_psnr
    from registry.toolkit.views import subject_of, view_angles

    from ..confidence_picture import CONFIDENCE, GUESSED, hatched, with_scale

    scene, place = run.scene, folder / CONFIDENCE
    place.mkdir(exist_ok=True)
    training = [view.camera for view in scene.train]
    points = None if scene.points is None else scene.points.positions
    rows: dict[str, dict[str, float]] = {}
    for view in views:
        its, rgb = confidence.of(view.camera), run.rendering(view.camera).rgb
        save_png(hatched(rgb, its), place / f"{view.name}.png")
        save_png(with_scale(its), place / f"{view.name}-scale.png")
        counted = its >= 0 if view.mask is None else view.mask
        subject = subject_of(view.camera, scene.bounds, points)
        rows[view.name] = {
            "sure": float((its[counted] >= GUESSED).double().mean()),
            "predicted": predicted_psnr(its[counted]),
            "measured": decibels((rgb - view.image).square()[counted].mean()),
            "angle": view_angles(view.camera, training, subject).nearest,
        }
    content = {"estimator": name, "iteration": run.iteration, "views": rows}
    write_text(place / f"{CONFIDENCE}.json", f"{json.dumps(content, indent=1)}\n")
    return place, sum(row["sure"] for row in rows.values()) / len(rows)
