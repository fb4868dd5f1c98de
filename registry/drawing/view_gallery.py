"""Several runs' renders of the same views, beside the photograph, on a web page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..web_page import choice, figure, image, note, pinned
from .pictures import ViewPictures

MOST_VIEWS = 12
"""More than these are shown in part: each has a render and a depth of each run."""
_LONGEST_SIDE = 640
"""Pixels of a picture; there may be hundreds."""


@dataclass(frozen=True)
class RenderedRun:
    """One run.

    Args:
        label: what tells it from the others.
        folder: of its renders.
        scores: of each test view by metric; None where a metric has none.
    """

    label: str
    folder: Path
    scores: Mapping[str, Mapping[str, float | None]]


def view_gallery(runs: Sequence[RenderedRun]) -> str:
    """A part for each test view, one shown at a time: the photograph pinned beside all renders and depths.

    Views and runs without pictures are left out; empty if none has any.
    """
    names = list(dict.fromkeys(name for run in runs for name in run.scores))
    count = min(len(names), MOST_VIEWS)
    some = [names[index * len(names) // count] for index in range(count)]
    parts = {name: part for name in some if (part := _part(name, runs))}
    hidden = len(names) - len(parts)
    remark = f"{hidden} more test views lie in the runs' folders." if hidden and parts else ""
    return choice("view", parts) + (note(remark) if remark else "")


def _part(name: str, runs: Sequence[RenderedRun]) -> str:
    photograph, figures = "", []
    for run in runs:
        files = ViewPictures.of(name, run.folder)
        needed = (files.render, files.depth, files.comparison)
        if name not in run.scores or not all(file.is_file() for file in needed):
            continue
        photograph = photograph or figure(f"{name}: photograph", _photograph(files))
        scores = (f"{metric} {s:.4g}" for metric, s in run.scores[name].items() if s is not None)
        images = image(files.render, "render", _LONGEST_SIDE)
        images += image(files.depth, "depth", _LONGEST_SIDE)
        figures.append(figure(", ".join([run.label, *scores]), images))
    return pinned(photograph, figures) if figures else ""


def _photograph(files: ViewPictures) -> str:
    """Cut out of truth, render, depth side by side; a run keeps it nowhere else."""
    from PIL import Image

    with Image.open(files.render) as one, Image.open(files.comparison) as picture:
        return image(picture.crop((0, 0, *one.size)), "photograph", _LONGEST_SIDE)
