"""Runs, their means and published rows as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich import box
from rich.cells import cell_len
from rich.table import Table

from registry.commands import ABSENT
from registry.pipeline import load_protocol

from .comparison import FinishedRun, MethodMean, method_means, metric_names
from .differences import labels
from .paper_tables import PaperTables

_FOLDED = 8
"""Letters of a name that a line shows at least."""
_BETWEEN = 2
"""Columns of text between two of the table."""
_COSTS = {"gaussians": "Gaussians", "seconds": "seconds", "peak_memory_mb": "memory MB"}


@dataclass(frozen=True)
class Published:
    """What a paper reports for one protocol."""

    tables: PaperTables
    protocol: str


def comparison_table(
    runs: Sequence[FinishedRun], published: Published | None, reason: str = ""
) -> Table:
    """Runs, their means over scenes, and published rows.

    Args:
        reason: why the runs are not in a table before this one.
    """
    metrics = metric_names(runs) or list(published.tables.metrics if published else ())
    table = Table(
        title=_title(runs, published),
        box=box.SIMPLE,
        title_justify="left",
        caption_justify="left",
        pad_edge=False,
        collapse_padding=True,
    )
    for column in ("run", "method", "scene"):
        table.add_column(column, overflow="fold")
    for column in (*metrics, *_COSTS.values()):
        table.add_column(column, justify="right", no_wrap=True)
    for finished, method in zip(runs, labels(runs), strict=True):
        numbers = {**finished.scores, **{key: finished.results.get(key) for key in _COSTS}}
        label = (finished.folder.name, method, finished.scene)
        table.add_row(*label, *_cells(numbers, metrics))
    captions = _add_means(table, method_means(runs), metrics)
    if reason:
        captions.append(f"Not in a table above, for {reason}.")
    if published is not None:
        captions += _add_published(table, published, metrics, runs)
    table.caption = "\n".join(captions) or None
    return table


def narrowest(table: Table) -> int:
    """Columns of text that a comparison needs: names may be folded to a few letters, numbers not."""
    needed = 0
    for column in table.columns:
        whole = max(cell_len(str(text)) for text in (column.header, *column.cells))
        needed += _BETWEEN + (whole if column.no_wrap else min(whole, _FOLDED))
    return needed


def _title(runs: Sequence[FinishedRun], published: Published | None) -> str:
    protocol = runs[0].protocol if runs else published.protocol if published else None
    return f"protocol {protocol}" if protocol else "no protocol"


def _add_means(table: Table, means: Sequence[MethodMean], metrics: Sequence[str]) -> list[str]:
    """Rows of means if there are several scenes; returns remarks for below the table."""
    covered = {mean.scenes for mean in means}
    if max((len(scenes) for scenes in covered), default=0) < 2:
        return []
    if len(covered) > 1:
        parts = "; ".join(f"{mean.method}: {', '.join(mean.scenes)}" for mean in means)
        return [f"No means: the methods were run on different scenes ({parts})."]
    table.add_section()
    for mean in means:
        scenes = f"mean of {len(mean.scenes)}"
        table.add_row("", mean.method, scenes, *_cells(mean.numbers, metrics))
    return []


def _add_published(
    table: Table, published: Published, metrics: Sequence[str], runs: Sequence[FinishedRun]
) -> list[str]:
    """The published rows; returns remarks for below the table."""
    tables, protocol = published.tables, published.protocol
    scenes = load_protocol(protocol).scenes
    costs = tables.overhead.get(protocol, {})
    table.add_section()
    for method, row in tables.results[protocol].items():
        numbers: dict[str, float | None] = {}
        if row is not None:
            numbers.update(zip(tables.metrics, row, strict=True))
        if method in costs:
            numbers["gaussians"] = costs[method].gaussians
        label = ("published", tables.methods[method], f"mean of {len(scenes)}")
        table.add_row(*label, *_cells(numbers, metrics))
    remarks = [f"Published: {tables.source}; means over {', '.join(scenes)}.", *tables.notes]
    if protocol in tables.protocol_notes:
        remarks.append(tables.protocol_notes[protocol])
    if runs:
        ours = ", ".join(sorted({finished.scene for finished in runs}))
        remarks.append(f"Ours: {ours}. A mean over other scenes is no reproduction.")
    return remarks


def _cells(numbers: Mapping[str, float | None], metrics: Sequence[str]) -> list[str]:
    scores = [numbers.get(name) for name in metrics]
    costs = [numbers.get(name) for name in _COSTS]
    return [
        *(ABSENT if score is None else _score(score) for score in scores),
        *(ABSENT if cost is None else f"{cost:,.0f}" for cost in costs),
    ]


def _score(value: float) -> str:
    """To as many digits as papers print."""
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"
