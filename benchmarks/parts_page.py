"""The records of `benchmarks.parts` as tables, beside what the paper reports."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from itertools import product

from benchmarks.parts_plan import (
    CLASSICAL,
    EIGHT,
    NOTHING,
    TABLES,
    TERM_TABLE,
    PartsRun,
    Row,
    Table,
)
from benchmarks.scores import HEADINGS, mean_over_scenes, score_of
from benchmarks.spread import NONE, spread
from benchmarks.training_records import Record as AnyRecord
from benchmarks.training_records import processor
from stereogs_plugins.tools.experiments.comparing.paper_tables import Ablation, paper_tables
from stereogs_plugins.tools.experiments.showing.paired import difference

Record = AnyRecord[PartsRun]
Records = Sequence[Record]

BEGIN = "<!-- measured: `make parts` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
PAPER = "stereogs"
PARTS = {
    "initializer": ("dense points", "initialization"),
    "stereo_depth": ("stereo depth", "stereo_depth"),
    "opacity": ("decay", "opacity_decay"),
}
"""What ablation files toggle, with its name here and in the paper's table."""
NOTES = """\
PSNR is over a scene's test views, ± the sample standard deviation over seeds where there are several.
*to ...* and what parts add are mean differences in PSNR over pairs of the same scene and seed, with their
95 % interval (Student's t) from three pairs on. The other scores and Gaussians are means over scenes; LPIPS
is by VGG unless it says Alex, AVGE by VGG. *asked* is how often the stereo network was asked, *of the time*
what share of initialization and training it took. *paper* are averages over all scenes of a data set, with
the paper's networks and 30,000 iterations, from
{source}.

{done} of {planned} runs, on {devices}. Those that differ in the stereo term alone went on from one moment
of one training, that before the term begins, to the bits of whole runs.
"""


def page_text(records: Records, planned: int) -> str:
    """The measured part of the page, in Markdown."""
    parts = []
    eight, classical = _rows(EIGHT, records), _rows(CLASSICAL, records)
    if eight or classical:
        parts += ["### What each part adds\n", _each_part(eight, classical)]
    for table in TABLES:
        # One that has only rows of the tables before it says nothing yet.
        if any(record.run.rows[0].table == table.title for record in records):
            parts += [f"### {table.title}\n", _table(table, _rows(table, records))]
    devices = dict.fromkeys(processor(record) for record in records)
    parts.append(
        NOTES.format(
            source=paper_tables(PAPER).source,
            done=len(records),
            planned=planned,
            devices=" and ".join(devices) or "no device yet",
        )
    )
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
    headings += ["asked", "of the time"] if table is TERM_TABLE else []
    paper = _paper(table)
    headings += ["paper"] if paper else []
    left = len(PARTS) if table.toggles else 1
    lines = [headings, ["---"] * left + ["---:"] * (len(headings) - left)]
    for label, records in rows.items():
        first = _ticks(label) if table.toggles else [label]
        cells = _scores(table, records, rows.get(table.baseline, []), label)
        cells += _questions(records) if table is TERM_TABLE else []
        lines.append([*first, *cells, *([_published(paper, label, table)] if paper else [])])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _scores(table: Table, records: Records, baseline: Records, label: str) -> list[str]:
    by_scene = [[r for r in records if r.run.case is case] for case in table.cases]
    return [
        " + ".join(str(len(of_scene)) for of_scene in by_scene),
        *(spread([record.scores["psnr"] for record in of_scene]) for of_scene in by_scene),
        NONE if label == table.baseline else _gain(records, baseline),
        *(mean_over_scenes(by_scene, score_of(name), ".3f") for name in HEADINGS),
        mean_over_scenes(by_scene, lambda record: record.measured["gaussians"], ",.0f"),
    ]


def _questions(records: Records) -> list[str]:
    """How often the stereo network was asked, and its share of the run's seconds."""
    logged = [(record.measured["logged"], record.measured["seconds"]) for record in records]
    asked = [
        said["stereo_depth_inferences"] for said, _ in logged if "stereo_depth_baseline" in said
    ]
    if not asked:
        return [NONE, NONE]
    shares = [said["stereo_depth_seconds"] / seconds for said, seconds in logged]
    return [f"{statistics.mean(asked):.0f}", f"{statistics.mean(shares):.0%}"]


def _each_part(*of_tables: Mapping[str, Records]) -> str:
    """What a part gains beside each choice of the others, over pairs of the same scene and seed."""
    paper = _paper(EIGHT)
    headings = ["part", "beside", "with networks", "without", "paper"]
    lines = [headings, ["---", "---", "---:", "---:", "---:"]]
    for part in PARTS:
        others = [other for other in PARTS if other != part]
        for on in product((False, True), repeat=len(others)):
            beside = [other for other, is_on in zip(others, on, strict=True) if is_on]
            without, with_it = _label(beside), _label([*beside, part])
            lines.append(
                [
                    PARTS[part][0],
                    " and ".join(PARTS[other][0] for other in beside) or NOTHING,
                    *(_gain(rows.get(with_it, []), rows.get(without, [])) for rows in of_tables),
                    _papers_gain(paper, with_it, without),
                ]
            )
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _gain(records: Records, baseline: Records) -> str:
    """The mean difference in PSNR over pairs of the same scene and seed, with its interval."""
    found = difference(_psnr(records), _psnr(baseline))
    return NONE if found is None else found.text()


def _label(on: Sequence[str]) -> str:
    """The row in which these parts are on."""
    return ", ".join(part for part in PARTS if part in on) or NOTHING


def _ticks(label: str) -> list[str]:
    return ["✓" if part in label.split(", ") else "✗" for part in PARTS]


def _psnr(records: Records) -> dict[tuple[str, int], float]:
    return {(record.run.case.data, record.run.seed): record.scores["psnr"] for record in records}


def _paper(table: Table) -> Ablation | None:
    return paper_tables(PAPER).ablations[table.paper] if table.paper else None


def _papers_psnr(paper: Ablation | None, label: str, protocol: str) -> float | None:
    """The paper's first metric of the row that a label names."""
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
