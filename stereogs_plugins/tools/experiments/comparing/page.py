"""A comparison as one HTML page that needs no other file: the tables, and all renders of each test view."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from registry.runs import RENDERS
from registry.toolkit.web_page import Cell, note, page, score_table, section

from ..showing.view_gallery import RenderedRun, view_gallery
from .comparison import FinishedRun
from .differences import labels
from .formats import cells


def as_page(runs: Sequence[FinishedRun], tables: Sequence[Table]) -> str:
    """The whole page.

    Args:
        runs: whose renders are shown, scene by scene.
        tables: as `comparison_table` makes them.
    """
    contents = [_table(table) for table in tables]
    for scene in dict.fromkeys(run.scene for run in runs):
        contents.append(section(scene, _gallery([run for run in runs if run.scene == scene])))
    return page("Comparison of runs", contents)


def _table(table: Table) -> str:
    header, *rows = cells(table)
    names = sum(column.justify != "right" for column in table.columns)
    remarks = str(table.caption or "").splitlines()
    body = [[Cell(text) for text in row] for row in rows]
    return score_table(header, body, names=names, caption=str(table.title)) + "".join(
        note(remark) for remark in remarks
    )


def _gallery(runs: Sequence[FinishedRun]) -> str:
    return view_gallery(
        [
            RenderedRun(
                f"{run.folder.name}: {label}",
                run.folder / RENDERS,
                run.results.get("views", {}).get("test", {}),
            )
            for run, label in zip(runs, labels(runs), strict=True)
        ]
    )
