"""Ablation or bench as one HTML page that needs no other file: tables, plots, renders and depths."""

from __future__ import annotations

from collections.abc import Sequence

from registry.runs import RENDERS
from registry.toolkit.web_page import Cell, grid, note, page, score_table, section

from ..planning.plan import Plan
from ..running.folder import AblationFolder
from . import table
from .against_time import Reference, against_time
from .differences import differences
from .plots import plots
from .samples import read_curves
from .scores import Results
from .view_gallery import RenderedRun, view_gallery, view_wipes


def as_page(
    plan: Plan, results: Results, folder: AblationFolder, references: Sequence[Reference] = ()
) -> str:
    """The whole page. Pictures are of the first seed.

    Args:
        references: published rows that curves are drawn beside.
    """
    timed = plan.kind == "bench"
    curves = read_curves(results, folder) if timed else {}
    contents = [
        note(
            f"{plan.size}. Bold: the best of a column. Seconds are those of training; in all, with "
            "what comes before and after."
        ),
        *(_table(plan, results, title, scene) for title, scene in table.titles(plan)),
        *_differences(plan, results),
        *(note(line) for line in table.notes(plan, results)),
        section("Against seconds", against_time(plan, results, curves, references)),
        section("Plots", grid(list(plots(plan, results)))),
        *(section(scene, _pictures(plan, results, folder, scene)) for scene in plan.scenes),
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


def _differences(plan: Plan, results: Results) -> list[str]:
    gained = differences(plan, results)
    if gained is None:
        return []
    chosen, _ = table.headings(plan, results)
    rows = []
    for combination, texts in zip(plan.combinations, gained.rows, strict=True):
        toggles, choices = table.labels(combination)
        rows.append([Cell(text) for text in (*toggles, *choices, *texts)])
    head = [*chosen, *gained.headings]
    return [score_table(head, rows, names=len(chosen), caption=gained.title)]


def _pictures(plan: Plan, results: Results, folder: AblationFolder, scene: str) -> str:
    """Each test view's photograph, and each combination's render and depth of it.

    A bench wipes renders over the photograph; an ablation, whose renders differ in little, shows all at once.
    """
    shown = view_wipes if plan.kind == "bench" else view_gallery
    return shown(
        [
            RenderedRun(
                plan.describe(run.combination),
                folder.run(run).path / RENDERS,
                found.get("views", {}).get("test", {}),
            )
            for run, found in results.items()
            if run.scene == scene and run.seed == plan.seeds[0]
        ]
    )
