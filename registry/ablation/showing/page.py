"""The ablation as one HTML page that needs no other file: tables, plots, renders and depths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PIL import Image

from ...drawing.pictures import ViewPictures
from ...runs.results import RENDERS
from ...web_page import Cell, figure, grid, image, note, page, score_table, section
from ..planning.plan import Plan
from ..running.folder import AblationFolder
from . import table
from .plots import plots
from .scores import Results

_LONGEST_SIDE = 640
"""Pixels of a picture; there may be hundreds."""


def as_page(plan: Plan, results: Results, folder: AblationFolder) -> str:
    """The whole page. Pictures are of the first seed and each scene's first test view."""
    contents = [
        note(f"{plan.size}. Bold: the best of a column."),
        *(_table(plan, results, title, scene) for title, scene in table.titles(plan)),
        *(note(line) for line in table.notes(plan, results)),
        section("Plots", grid(list(plots(plan, results)))),
        *(section(scene, grid(_pictures(plan, results, folder, scene))) for scene in plan.scenes),
    ]
    return page(f"{plan.kind.capitalize()}: {plan.name}", contents)


def _table(plan: Plan, results: Results, caption: str, scene: str | None) -> str:
    chosen, measured = table.headings(plan, results)
    found = table.rows(plan, results, scene)
    incomplete = any(row.progress for row in found)
    rows = [
        [
            *(Cell(text) for text in (*row.toggles, *row.values)),
            *(Cell(text, best) for text, best in zip(row.numbers, row.best, strict=True)),
            *([Cell(row.progress)] * incomplete),
        ]
        for row in found
    ]
    head = [*chosen, *measured, *(["runs"] * incomplete)]
    return score_table(head, rows, names=len(chosen), caption=caption)


def _pictures(plan: Plan, results: Results, folder: AblationFolder, scene: str) -> list[str]:
    """The photograph of the first test view, then each combination's render and depth of it."""
    figures: list[str] = []
    for run, found in results.items():
        views: Mapping[str, Any] = found.get("views", {}).get("test", {})
        if run.scene != scene or run.seed != plan.seeds[0] or not views:
            continue
        name, scores = next(iter(views.items()))
        files = ViewPictures.of(name, folder.run(run).path / RENDERS)
        if not all(file.is_file() for file in (files.render, files.depth, files.comparison)):
            continue
        if not figures:
            figures.append(figure(f"{name}: photograph", _photograph(files)))
        caption = [plan.describe(run.combination), *_scores(scores)]
        images = image(files.render, "render", _LONGEST_SIDE)
        images += image(files.depth, "depth", _LONGEST_SIDE)
        figures.append(figure(", ".join(caption), images))
    return figures


def _scores(view: Mapping[str, float | None]) -> list[str]:
    return [f"{name} {score:.4g}" for name, score in view.items() if score is not None]


def _photograph(files: ViewPictures) -> str:
    """Cut out of truth, render, depth side by side; the run keeps it nowhere else."""
    with Image.open(files.render) as one, Image.open(files.comparison) as picture:
        return image(picture.crop((0, 0, *one.size)), "photograph", _LONGEST_SIDE)
