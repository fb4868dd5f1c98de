"""A part of a page that shows the renders of several runs next to the photographs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from registry.messages.suggestions import counted
from registry.toolkit.drawing import ViewPictures
from registry.toolkit.web_page import choice, figure, image, note, wipe
from registry.toolkit.web_page.document import pinned

MAX_VIEWS = 12
"""Largest number of views on a page; each has a render and a depth map per run."""
_DEPTHS = "Depth maps: yellow is near, dark blue is far, black is empty."
_LONGEST_SIDE = 640
"""Pixels of an image; a page may have hundreds."""


@dataclass(frozen=True)
class RenderedRun:
    """A run on a page.

    Args:
        label: name on the page.
        folder: of its renders.
        scores: metrics by test view; None for a missing score.
    """

    label: str
    folder: Path
    scores: Mapping[str, Mapping[str, float | None]]


def view_gallery(runs: Sequence[RenderedRun]) -> str:
    """Return a menu of test views; each shows the photograph next to the renders and depths of all runs.

    Views and runs without images are omitted; empty if there are no images.
    """
    return _some_views(runs, _pinned)


def view_wipes(runs: Sequence[RenderedRun]) -> str:
    """Return the same as `view_gallery`, but show one run at a time, over the photograph with a slider."""
    return _some_views(runs, _wiped)


def _some_views(
    runs: Sequence[RenderedRun], part_of: Callable[[str, Sequence[RenderedRun]], str]
) -> str:
    names = list(dict.fromkeys(name for run in runs for name in run.scores))
    count = min(len(names), MAX_VIEWS)
    some = [names[index * len(names) // count] for index in range(count)]
    parts = {name: part for name in some if (part := part_of(name, runs))}
    hidden = len(names) - len(parts)
    if not parts:
        return ""
    more = note(f"The run folders hold {counted(hidden, 'more test view')}.") if hidden else ""
    return choice("view", parts) + note(_DEPTHS) + more


def _pinned(name: str, runs: Sequence[RenderedRun]) -> str:
    found = list(_with_pictures(name, runs))
    if not found:
        return ""
    figures = [
        figure(
            f"{_caption(name, run)}; render and depth",
            _image(files.render, "render") + _image(files.depth, "depth"),
        )
        for run, files in found
    ]
    return pinned(figure(f"{name}: photograph", _photograph(found[0][1])), figures)


def _wiped(name: str, runs: Sequence[RenderedRun]) -> str:
    parts = {}
    for run, files in _with_pictures(name, runs):
        compared = wipe(
            _photograph(files), _image(files.render, "render"), ("photograph", "render")
        )
        depth = figure("depth", _image(files.depth, "depth"))
        parts[run.label] = figure(_caption(name, run), compared) + depth
    return choice("render of", parts)


def _with_pictures(
    name: str, runs: Sequence[RenderedRun]
) -> Iterator[tuple[RenderedRun, ViewPictures]]:
    """Yield the runs that have images of a view."""
    for run in runs:
        files = ViewPictures.of(name, run.folder)
        needed = (files.render, files.depth, files.comparison)
        if name in run.scores and all(file.is_file() for file in needed):
            yield run, files


def _caption(name: str, run: RenderedRun) -> str:
    scores = (f"{metric} {s:.4g}" for metric, s in run.scores[name].items() if s is not None)
    return ", ".join([run.label, *scores])


def _image(file: Path, alt: str) -> str:
    return image(file, alt, _LONGEST_SIDE)


def _photograph(files: ViewPictures) -> str:
    """Crop the photograph from the comparison image, the only file that holds it."""
    from PIL import Image

    with Image.open(files.render) as one, Image.open(files.comparison) as picture:
        return image(picture.crop((0, 0, *one.size)), "photograph", _LONGEST_SIDE)
