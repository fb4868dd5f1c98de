"""Tables of runs, means over scenes and published rows, and a page with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from registry.messages.suggestions import counted
from registry.pipeline.protocols import load_protocol
from registry.runs.results import RENDERS
from registry.toolkit.web_page import Cell, page, section

from ...command_line.output import ABSENT
from ..showing.score_table import ScoreTable, csv_text
from ..showing.scores import CONFIDENCE, Figure
from ..showing.view_gallery import RenderedRun, view_gallery
from .comparison import COSTS, FinishedRun, method_means, metric_names, seed_means
from .labels import labels
from .paper_tables import PaperTables

Numbers = Mapping[str, float | Figure | None]
Row = tuple[str, str, str, Numbers]
"""Run, method, scene, and numbers."""


@dataclass(frozen=True)
class Published:
    """The numbers of a paper for one protocol."""

    tables: PaperTables
    protocol: str


def comparison_table(
    runs: Sequence[FinishedRun], published: Published | None, reason: str = ""
) -> ScoreTable:
    """Return a table of runs, means over seeds, means over scenes, and published rows.

    `reason` says why the runs are not in the first table.
    """
    metrics = metric_names(runs) or list(published.tables.metrics if published else ())
    rows: list[Row] = [
        (run.folder.name, method, run.scene, run.numbers)
        for run, method in zip(runs, labels(runs), strict=True)
    ]
    sections, notes = [len(rows)], list[str]()
    methods = dict(zip(map(id, runs), labels(runs, seeds=False), strict=True))
    over_seeds = seed_means(runs)
    rows += [
        ("", methods[id(first)], f"{first.scene}, mean of {counted(seeds, 'seed')}", means)
        for first, seeds, means in over_seeds
    ]
    if any(mean.half is not None for *_, found in over_seeds for mean in found.values()):
        notes.append(f"± of means over seeds: {CONFIDENCE:.0%} confidence interval (Student's t).")
    sections.append(len(rows))
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


def _cells(numbers: Numbers, metrics: Sequence[str]) -> list[Cell]:
    scores = [_text(numbers.get(name)) for name in metrics]
    costs = [_text(numbers.get(name), 0) for name in COSTS]
    return [Cell(text) for text in (*scores, *costs)]


def _text(value: float | Figure | None, decimals: int | None = None) -> str:
    """Format a score with as many digits as papers use, a mean over seeds with its interval."""
    if value is None:
        return ABSENT
    mean, half = (value.mean, value.half) if isinstance(value, Figure) else (value, None)
    if decimals is None:
        decimals = 3 if abs(mean) < 1 else 2
    else:
        half = None  # the spread of counts and times says little about a method
    return f"{mean:,.{decimals}f}" + ("" if half is None else f" ± {half:,.{decimals}f}")


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
