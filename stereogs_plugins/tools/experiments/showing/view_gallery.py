"""Several runs' renders of the same views, beside the photograph, on a web page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from registry.toolkit.drawing import ViewPictures
from registry.toolkit.web_page import choice, figure, image, note, pinned, wipe

MOST_VIEWS = 12
"""More than these are shown in part: each has a render and a depth of each run."""
_DEPTHS = "In depths, what is near is yellow, what is far dark blue, and nothing is there where it is black."
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
    return _some_views(runs, _pinned)


def view_wipes(runs: Sequence[RenderedRun]) -> str:
    """As `view_gallery`, but each render is wiped over the photograph, one run's at a time."""
    return _some_views(runs, _wiped)


def _some_views(
    runs: Sequence[RenderedRun], part_of: Callable[[str, Sequence[RenderedRun]], str]
) -> str:
    names = list(dict.fromkeys(name for run in runs for name in run.scores))
    count = min(len(names), MOST_VIEWS)
    some = [names[index * len(names) // count] for index in range(count)]
    parts = {name: part for name in some if (part := part_of(name, runs))}
    hidden = len(names) - len(parts)
    remark = f"{hidden} more test views lie in the runs' folders." if hidden and parts else ""
    return (
        choice("view", parts) + (note(_DEPTHS) if parts else "") + (note(remark) if remark else "")
    )


def _pinned(name: str, runs: Sequence[RenderedRun]) -> str:
    found = list(_with_pictures(name, runs))
    figures = [
        figure(f"{_caption(name, run)}; render and depth", _render(files) + _depth(files))
        for run, files in found
    ]
    return pinned(figure(f"{name}: photograph", _photograph(found[0][1])), figures) if found else ""


def _wiped(name: str, runs: Sequence[RenderedRun]) -> str:
    labels = ("photograph", "render")
    return choice(
        "render of",
        {
            run.label: figure(_caption(name, run), wipe(_photograph(files), _render(files), labels))
            + figure("depth", _depth(files))
            for run, files in _with_pictures(name, runs)
        },
    )


def _with_pictures(
    name: str, runs: Sequence[RenderedRun]
) -> Iterator[tuple[RenderedRun, ViewPictures]]:
    """The runs that have a view's pictures."""
    for run in runs:
        files = ViewPictures.of(name, run.folder)
        needed = (files.render, files.depth, files.comparison)
        if name in run.scores and all(file.is_file() for file in needed):
            yield run, files


def _caption(name: str, run: RenderedRun) -> str:
    scores = (f"{metric} {s:.4g}" for metric, s in run.scores[name].items() if s is not None)
    return ", ".join([run.label, *scores])


def _render(files: ViewPictures) -> str:
    return image(files.render, "render", _LONGEST_SIDE)


def _depth(files: ViewPictures) -> str:
    return image(files.depth, "depth", _LONGEST_SIDE)


def _photograph(files: ViewPictures) -> str:
    """Cut out of truth, render, depth side by side; a run keeps it nowhere else."""
    from PIL import Image

    with Image.open(files.render) as one, Image.open(files.comparison) as picture:
        return image(picture.crop((0, 0, *one.size)), "photograph", _LONGEST_SIDE)
