"""Tables of runs, means over scenes and published rows, and a page with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from registry.pipeline.protocols import load_protocol
from registry.runs.results import RENDERS
from registry.toolkit.web_page import Cell, page, section

from ...command_line.output import ABSENT
from ..showing.score_table import ScoreTable, csv_text
from ..showing.view_gallery import RenderedRun, view_gallery
from .comparison import COSTS, FinishedRun, method_means, metric_names
from .labels import labels
from .paper_tables import PaperTables

Row = tuple[str, str, str, Mapping[str, float | None]]
"""Run, method, scene, and numbers."""


@dataclass(frozen=True)
class Published:
    """The numbers of a paper for one protocol."""

    tables: PaperTables
    protocol: str


def comparison_table(
    runs: Sequence[FinishedRun], published: Published | None, reason: str = ""
) -> ScoreTable:
    """Return a table of runs, means over scenes, and published rows.

    `reason` says why the runs are not in the first table.
    """
    metrics = metric_names(runs) or list(published.tables.metrics if published else ())
    rows: list[Row] = [
        (run.folder.name, method, run.scene, run.numbers)
        for run, method in zip(runs, labels(runs), strict=True)
    ]
    sections, notes = [len(rows)], []
    means = method_means(runs)
    covered = {mean.scenes for mean in means}
    if len(covered) > 1:
        parts = "; ".join(f"{mean.method}: {', '.join(mean.scenes)}" for mean in means)
        notes.append(f"No means: the methods were run on different scenes ({parts}).")
    elif any(len(scenes) > 1 for scenes in covered):
        rows += [("", m.method, f"mean of {len(m.scenes)}", m.numbers) for m in means]
    sections.append(len(rows))
    if reason:
        notes.append(f"Separate table because {reason}.")
    if published is not None:
        rows += _published_rows(published)
        notes += _published_notes(published, runs)
    return ScoreTable(
        _title(runs, published),
        ["run", "method", "scene", *metrics, *COSTS.values()],
        3,
        [[*map(Cell, names), *_cells(numbers, metrics)] for *names, numbers in rows],
        notes,
        sections,
    )


def _title(runs: Sequence[FinishedRun], published: Published | None) -> str:
    protocol = runs[0].protocol if runs else published.protocol if published else None
    return f"protocol {protocol}" if protocol else "no protocol"


def _published_rows(published: Published) -> Iterator[Row]:
    tables, protocol = published.tables, published.protocol
    scenes = f"mean of {len(load_protocol(protocol).scenes)}"
    costs = tables.overhead.get(protocol, {})
    for method, row in tables.results[protocol].items():
        numbers: dict[str, float | None] = {}
        if row is not None:
            numbers.update(zip(tables.metrics, row, strict=True))
        if method in costs:
            numbers["gaussians"] = costs[method].gaussians
        yield "published", tables.methods[method], scenes, numbers


def _published_notes(published: Published, runs: Sequence[FinishedRun]) -> Iterator[str]:
    tables, protocol = published.tables, published.protocol
    yield f"Published: {tables.source}; means over {', '.join(load_protocol(protocol).scenes)}."
    yield from tables.notes
    if protocol in tables.protocol_notes:
        yield tables.protocol_notes[protocol]
    if runs:
        ours = ", ".join(sorted({run.scene for run in runs}))
        yield f"Ours: {ours}. Means over different scenes are not comparable."


def _cells(numbers: Mapping[str, float | None], metrics: Sequence[str]) -> list[Cell]:
    scores = [numbers.get(name) for name in metrics]
    costs = [numbers.get(name) for name in COSTS]
    texts = [
        *(ABSENT if score is None else _score(score) for score in scores),
        *(ABSENT if cost is None else f"{cost:,.0f}" for cost in costs),
    ]
    return [Cell(text) for text in texts]


def _score(value: float) -> str:
    """Format with as many digits as papers use."""
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def as_csv(runs: Sequence[FinishedRun]) -> str:
    """Return a line per run, with the numbers of results.json; missing ones are empty."""
    metrics = metric_names(runs)
    head = ["run", "method", "protocol", "scene", *metrics, *COSTS]
    rows = [
        [
            *(run.folder, label, run.protocol, run.scene),
            *map(run.scores.get, metrics),
            *map(run.results.get, COSTS),
        ]
        for run, label in zip(runs, labels(runs), strict=True)
    ]
    return csv_text(head, rows)


def as_page(runs: Sequence[FinishedRun], tables: Sequence[ScoreTable]) -> str:
    """Return an HTML page without other files: the tables, and the renders of each test view."""
    contents = [table.html() for table in tables]
    for scene in dict.fromkeys(run.scene for run in runs):
        contents.append(section(scene, _gallery([run for run in runs if run.scene == scene])))
    return page("Comparison of runs", contents)


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
