"""The records of `benchmarks.parts_plan` as tables, next to the paper's numbers."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from itertools import product

from benchmarks.cells import HEADINGS, NONE, count, gain, mean_over_scenes, score_of, spread
from benchmarks.parts_plan import (
    CLASSICAL,
    EIGHT,
    NOTHING,
    TABLES,
    TERM_TABLE,
    PartsTraining,
    Row,
    Table,
)
from benchmarks.records import Record as AnyRecord
from stereogs.experiments.comparing.paper_tables import Ablation, paper_tables
from stereogs.experiments.showing.score_table import markdown

Record = AnyRecord[PartsTraining]
Records = Sequence[Record]

PAPER = "stereogs"
PARTS = {
    "initializer": ("dense points", "initialization"),
    "stereo_depth": ("stereo depth", "stereo_depth"),
    "opacity": ("decay", "opacity_decay"),
}
"""Names of the toggles of ablation files, here and in the paper's table."""
NOTES = """\
Columns are defined in [results](../../docs/results.md#columns). *to ...* is the gain over that row; the
columns after it are means over scenes. *inferences* is the number of inferences of the stereo network,
*of the time* its share of initialization and training. *paper* are averages over all scenes of a data set,
with the paper's networks and 30,000 iterations, from
{source}.

{count} Some runs that differ in the stereo term only shared the iterations before the term starts; each ended
in the bits of a whole run.
"""


def summary(records: Records) -> str:
    """Return the gain of each part, with and without networks, as a table."""
    return _each_part(_rows(EIGHT, records), _rows(CLASSICAL, records))


def tables(records: Records, planned: int) -> str:
    """Return all tables, with notes, in Markdown."""
    parts = []
    eight, classical = _rows(EIGHT, records), _rows(CLASSICAL, records)
    if eight or classical:
        parts += ["## Gain of each part\n", _each_part(eight, classical)]
    for table in TABLES:
        # Skip a table whose rows are all in the tables before it.
        if any(record.run.rows[0].table == table.title for record in records):
            parts += [f"## {table.title}\n", _table(table, _rows(table, records))]
    source = paper_tables(PAPER).source
    parts.append(NOTES.format(source=source, count=count(records, planned)))
    return "\n".join(parts)


def _rows(table: Table, records: Records) -> dict[str, list[Record]]:
    """The records of each row, in the order of the table."""
    found: dict[Row, list[Record]] = {}
    for record in records:
        for row in record.run.rows:
            if row.table == table.title:
                found.setdefault(row, []).append(record)
    return {row.label: found[row] for row in sorted(found, key=lambda row: row.place)}


def _table(table: Table, rows: dict[str, list[Record]]) -> str:
    scenes = [case.data for case in table.cases]
    headings = [
        *((name for name, _ in PARTS.values()) if table.toggles else ("form",)),
        "seeds",
        *scenes,
    ]
    headings += [f"to {table.baseline}", *HEADINGS.values(), "Gaussians"]
    headings += ["inferences", "of the time"] if table is TERM_TABLE else []
    paper = _paper(table)
    headings += ["paper"] if paper else []
    left = len(PARTS) if table.toggles else 1
    lines = []
    for label, records in rows.items():
        first = _ticks(label) if table.toggles else [label]
        cells = _scores(table, records, rows.get(table.baseline, []), label)
        cells += _inferences(records) if table is TERM_TABLE else []
        lines.append([*first, *cells, *([_published(paper, label, table)] if paper else [])])
    return markdown(headings, lines, left)


def _scores(table: Table, records: Records, baseline: Records, label: str) -> list[str]:
    by_scene = [[r for r in records if r.run.case is case] for case in table.cases]
    return [
        " + ".join(str(len(of_scene)) for of_scene in by_scene),
        *(spread([record.scores["psnr"] for record in of_scene]) for of_scene in by_scene),
        NONE if label == table.baseline else gain(records, baseline),
        *(mean_over_scenes(by_scene, score_of(name), ".3f") for name in HEADINGS),
        mean_over_scenes(by_scene, lambda record: record.measured["gaussians"], ",.0f"),
    ]


def _inferences(records: Records) -> list[str]:
    """Number of inferences of the stereo network, and its share of the run's seconds."""
    runs = [(record.measured["logged"], record.measured["seconds"]) for record in records]
    counts = [
        logged["stereo_depth_inferences"] for logged, _ in runs if "stereo_depth_baseline" in logged
    ]
    if not counts:
        return [NONE, NONE]
    shares = [logged["stereo_depth_seconds"] / seconds for logged, seconds in runs]
    return [f"{statistics.mean(counts):.0f}", f"{statistics.mean(shares):.0%}"]


def _each_part(*of_tables: Mapping[str, Records]) -> str:
    """The gain of a part for each choice of the others, over pairs of the same scene and seed."""
    paper = _paper(EIGHT)
    lines = []
    for part in PARTS:
        others = [other for other in PARTS if other != part]
        for on in product((False, True), repeat=len(others)):
            present = [other for other, is_on in zip(others, on, strict=True) if is_on]
            without, with_it = _label(present), _label([*present, part])
            lines.append(
                [
                    PARTS[part][0],
                    " and ".join(PARTS[other][0] for other in present) or NOTHING,
                    *(gain(rows.get(with_it, []), rows.get(without, [])) for rows in of_tables),
                    _papers_gain(paper, with_it, without),
                ]
            )
    return markdown(["part", "added to", "with networks", "without", "paper"], lines, names=2)


def _label(on: Sequence[str]) -> str:
    """The label of the row in which these parts are on."""
    return ", ".join(part for part in PARTS if part in on) or NOTHING


def _ticks(label: str) -> list[str]:
    return ["✓" if part in label.split(", ") else "✗" for part in PARTS]


def _paper(table: Table) -> Ablation | None:
    return paper_tables(PAPER).ablations[table.paper] if table.paper else None


def _papers_psnr(paper: Ablation | None, label: str, protocol: str) -> float | None:
    """The paper's first metric in the row of a label."""
    if paper is None:
        return None
    on = {name: part in label.split(", ") for part, (_, name) in PARTS.items()}
    for row in paper.rows:
        if row.setting == on or label in row.setting.values():
            numbers = row.results.get(protocol)
            return numbers[0] if numbers else None
    return None


def _published(paper: Ablation | None, label: str, table: Table) -> str:
    psnr = _papers_psnr(paper, label, table.cases[0].protocol)
    return NONE if psnr is None else f"{psnr:.2f}"


def _papers_gain(paper: Ablation | None, with_it: str, without: str) -> str:
    protocol = EIGHT.cases[0].protocol
    high, low = (_papers_psnr(paper, label, protocol) for label in (with_it, without))
    return NONE if high is None or low is None else f"{high - low:+.2f}"
