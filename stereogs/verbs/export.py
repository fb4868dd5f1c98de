"""Export a run to other file formats."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.calls.process_state import one_torch_thread
from registry.messages.suggestions import did_you_mean, listing
from registry.toolkit.cache.remote import on_this_machine

from ..command_line.arguments import add_run, open_given
from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import GaussianReader
    from registry.confidence import Trained
    from registry.pipeline.pipeline import Item
    from registry.runs.run import Run

MAX_LINES = 3
"""Largest number of files per folder that are listed one by one."""

_CAMERAS_PER_VIEW = 2
_MIN_LIGHT = 0.5
"""Light, in pixels of all cameras together, at which the confidence of a Gaussian is halved."""

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
            type=on_this_machine,
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

        find_exporter(arguments.format, arguments.set)  # fails before the scene is loaded
        opened = open_given(arguments, photographs=False)
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
            if len(inside) > MAX_LINES:
                output.print(f"exported  {len(inside)} files in {folder}")
            else:
                output.print(*(f"exported  {path}" for path in inside), sep="\n")
        return 0


def find_exporter(format_name: str, changes: Sequence[str] = ()) -> Item:
    """Return an exporter with its settings.

    Raises:
        ExplainedError: no such exporter, or wrong settings.
    """
    from registry.discovery import Plugins
    from registry.pipeline.edits import SECTIONS
    from registry.pipeline.single_item import single_item

    return single_item(Plugins().find(SECTIONS["exporters"], format_name), changes)


@one_torch_thread()
def export(
    run: Run,
    format_name: str,
    folder: str | os.PathLike[str] | None = None,
    *,
    changes: Sequence[str] = (),
    without: Sequence[str] = (),
    min_confidence: float | None = None,
) -> list[Path]:
    """Write the Gaussians of a run with any installed exporter.

    Args:
        format_name: name of the exporter: "ply", "gltf", ...
        folder: created if missing; None: `exports` in the run folder.
        changes: `key=value`, settings of the exporter.
        without: kinds of initial points whose Gaussians are left out, for example "margin"; see `Run.kinds`.
        min_confidence: in [0, 1]; Gaussians with less confidence are left out, and PLY and glTF files hold
            the confidence of the others.

    Returns:
        The files that were written.

    Raises:
        ExplainedError: no such exporter or kind, wrong settings, no folder, no Gaussian remains, or the
            exporter failed.
    """
    from registry.calls.copies import copied
    from registry.pipeline.parts import build_part
    from registry.runs.results import EXPORTS

    item = find_exporter(format_name, changes)
    place = on_this_machine(Path(folder or run.folder_or_refuse().path / EXPORTS)).expanduser()
    reader = _reader(run, without, min_confidence)
    place.mkdir(parents=True, exist_ok=True)
    part = build_part(item, run.pipeline.training.seed, run.engine_model.engine)
    files: list[Path] = part.call(reader, copied(run.scene), place)
    return files


def _reader(run: Run, kinds: Sequence[str], min_confidence: float | None) -> GaussianReader:
    """Return the Gaussians of a run except those of some kinds, and of low confidence."""
    import torch

    from core_rasterizer import Gaussians
    from registry.training.initial_model import new_model
    from registry.training.placed import PlacedGaussians

    if not kinds and min_confidence is None:
        return run.exported
    known, left_out = run.kinds, torch.zeros(run.engine_model.count, dtype=torch.bool)
    for kind in kinds:
        if kind not in known:
            raise RunError(
                f"the run's Gaussians have no kind {kind!r}{did_you_mean(kind, known)}",
                where="--without",
                fix=f"kinds: {listing(known)}"
                if known
                else "its initializer does not distinguish kinds, or an older version trained it",
            )
        left_out |= known[kind]
    attributes = run.features
    if min_confidence is not None:
        attributes["confidence"] = _confidence_of_gaussians(run.trained)
        left_out |= attributes["confidence"] < min_confidence
    if left_out.all():
        where = f"--without {','.join(kinds)}" if kinds else f"--min-confidence {min_confidence}"
        fix = "name fewer kinds with --without, or choose a lower --min-confidence"
        raise RunError("all Gaussians would be left out", where=where, fix=fix)
    kept = {name: values[~left_out] for name, values in vars(run.engine_model.gaussians()).items()}
    model = new_model(Gaussians(**kept), run.pipeline.training, run.engine_model.engine)
    rows = {name: values[~left_out] for name, values in attributes.items()}
    return PlacedGaussians(model, run.frame, rows)


def _confidence_of_gaussians(trained: Trained) -> Tensor:
    """Return `[N]` float32 in [0, 1]: the mean confidence of the pixels in which a Gaussian is seen.

    The pixels are those of cameras on a smooth path through the training cameras, because at the training
    cameras themselves a guess looks like the photograph. A Gaussian that no camera sees gets 0.
    """
    from registry.toolkit.drawing import smooth_path
    from registry.toolkit.views import gathered

    confidence = trained.confidence("calibrated")
    cameras = [view.camera for view in trained.scene.train]
    path = smooth_path(cameras, _CAMERAS_PER_VIEW * len(cameras)) if len(cameras) > 1 else cameras
    sums, light = gathered(trained.model, ((camera, confidence.of(camera)) for camera in path))
    return (sums / (light + _MIN_LIGHT)).clamp(0, 1)


def _names(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in text.split(","))))


def _share(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value
