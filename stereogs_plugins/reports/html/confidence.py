"""What is guessed in the rendered views, from the files of `stereogs render --confidence`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from registry import RunError
from registry.toolkit.drawing import ViewPictures
from registry.toolkit.progress import in_parallel
from registry.toolkit.web_page import (
    Cell,
    choice,
    figure,
    image,
    note,
    score_table,
    wipe,
)

from .renders import RENDERS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_CONFIDENCE = "confidence"
"""Subfolder of the folder with the renders, and name of its file of numbers."""
_NUMBERS = ("sure", "predicted", "measured", "angle")
"""Of each view: share of sure pixels, PSNR predicted and measured, degrees to the nearest training camera."""


def confidence(folder: Path, iterations: int | None) -> str:
    """Return a sentence, a part per view and a table; empty if confidence was not drawn.

    Args:
        folder: of the run.
        iterations: of the run, None if unknown; what was drawn after another one is left out.

    Raises:
        RunError: the file of numbers is damaged.
    """
    known = _read_confidence(folder / RENDERS)
    if not known.get("views") or known.get("iteration", iterations) != iterations:
        return ""
    views: Mapping[str, Any] = known["views"]
    sure = sum(row["sure"] for row in views.values()) / len(views)
    text = (
        f"The photographs determine {sure:.0%} of the pixels of these views: an error of at most 0.1 is "
        f"more likely there than not. The rest, hatched, is guessed. Estimator: {known['estimator']}."
    )
    parts = in_parallel(lambda name: _part(name, folder / RENDERS), list(views))
    return note(text) + choice("view", dict(zip(views, parts, strict=True))) + _table(views)


def _read_confidence(renders: Path) -> dict[str, Any]:
    """Return what `stereogs render --confidence` wrote about the views; empty if it did not.

    Raises:
        RunError: the file is damaged.
    """
    file = renders / _CONFIDENCE / f"{_CONFIDENCE}.json"
    if not file.is_file():
        return {}
    try:
        content = json.loads(file.read_text("utf-8"))
        for row in content["views"].values():
            for name in _NUMBERS:
                row[name] = float(row[name])
        content["estimator"] = str(content["estimator"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        fix = f"stereogs render {renders.parent} --confidence"
        raise RunError(f"the file is damaged: {error!r}", where=str(file), fix=fix) from error
    return dict(content)


def _part(name: str, renders: Path) -> str:
    render, place = ViewPictures.of(name, renders).render, renders / _CONFIDENCE
    both = wipe(
        image(render, "render"),
        image(place / f"{name}.png", "guessed parts hatched"),
        ("render", "guesses hatched"),
    )
    colors = figure("Confidence", image(place / f"{name}-scale.png", "confidence"))
    return f'<div class="sides">{figure(name, both)}{colors}</div>'


def _table(views: Mapping[str, Any]) -> str:
    rows = [
        [
            Cell(name),
            Cell(f"{row['angle']:.1f}"),
            Cell(f"{row['sure']:.0%}"),
            Cell(f"{row['predicted']:.1f}"),
            Cell(f"{row['measured']:.1f}"),
        ]
        for name, row in views.items()
    ]
    head = ["view", "degrees to nearest photograph", "sure", "PSNR predicted, dB", "PSNR, dB"]
    return score_table(head, rows)
