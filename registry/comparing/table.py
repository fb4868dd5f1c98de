"""Runs, their means and published rows as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table

from ..pipeline.protocols import load_protocol
from .comparison import FinishedRun, MethodMean, method_means, metric_names
from .paper_tables import PUBLISHED_METRICS, PaperTables
from .run_table import ABSENT

_COSTS = {"gaussians": "Gaussians", "seconds": "seconds", "peak_memory_mb": "memory MB"}


def comparison_table(
    runs: Sequence[FinishedRun], paper: str | None, tables: PaperTables | None
) -> Table:
    """Runs, their means over scenes, and published rows.

    Args:
        paper: the protocol whose published rows follow; needs `tables`.
    """
    metrics = metric_names(runs) or list(PUBLISHED_METRICS)
    table = Table(
        title=_title(runs, paper), box=box.SIMPLE, title_justify="left", caption_justify="left"
    )
    for column in ("run", "method", "scene"):
        table.add_column(column, no_wrap=True)
    for column in (*metrics, *_COSTS.values()):
        table.add_column(column, justify="right", no_wrap=True)
    for finished in runs:
        numbers = {**finished.scores, **{key: finished.results.get(key) for key in _COSTS}}
        label = (finished.folder.name, finished.pipeline, finished.scene)
        table.add_row(*label, *_cells(numbers, metrics))
    captions = _add_means(table, method_means(runs), metrics)
    if paper is not None and tables is not None:
        captions += _add_published(table, paper, tables, metrics, runs)
    table.caption = "\n".join(captions) or None
    return table


def _title(runs: Sequence[FinishedRun], paper: str | None) -> str:
    if runs:
        return f"protocol {runs[0].protocol}" if runs[0].protocol else "no protocol"
    return f"protocol {paper}"


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
    table: Table,
    paper: str,
    tables: PaperTables,
    metrics: Sequence[str],
    runs: Sequence[FinishedRun],
) -> list[str]:
    """The published rows; returns remarks for below the table."""
    published = load_protocol(paper).scenes
    costs = tables.overhead.get(paper, {})
    table.add_section()
    for method, triple in tables.results[paper].items():
        numbers: dict[str, float | None] = {}
        if triple is not None:
            numbers.update(zip(PUBLISHED_METRICS, triple, strict=True))
        if method in costs:
            numbers["gaussians"] = costs[method].gaussians
        label = ("published", tables.methods[method], f"mean of {len(published)}")
        table.add_row(*label, *_cells(numbers, metrics))
    remarks = [
        f"Published: {tables.source}; means over {', '.join(published)}.",
        tables.notes[0],
    ]
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
