"""The records of `benchmarks.methods_plan` as tables, next to the numbers of papers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from benchmarks.cells import (
    NONE,
    commonest_processor,
    count,
    cpu_seconds,
    gain,
    mean_over_scenes,
    score_of,
    scores_shown,
    spread,
    time_ratio,
)
from benchmarks.methods_plan import BASELINE, GROUPS, METHODS, Group, MethodTraining
from benchmarks.records import Record as AnyRecord
from benchmarks.trainings import Case, Method, Points
from stereogs.experiments.comparing.paper_tables import PaperTables, paper_tables
from stereogs.experiments.showing.score_table import markdown

Record = AnyRecord[MethodTraining]
Records = Sequence[Record]

PAPER = "stereogs"
TITLES: dict[Points, str] = {"own": "Own points", "same": "Same points"}
NOTES = """\
Columns are defined in [results](../../docs/results.md#columns). *mean* is over the scenes, and the columns
after it are means over the scenes of a row. *to 3DGS* is the gain over 3DGS in the same table. *CPU s* is of
the runs on the machine that made most runs of the table, *CPU / 3DGS* the ratio to 3DGS over the scenes
and machines that both were trained on. *paper* are averages over all scenes of a data set from
{source}. {notes}

{count}
"""


def summary(records: Records) -> str:
    """Return one table: PSNR of each method by protocol and first points, next to the paper's."""
    paper = paper_tables(PAPER)
    columns: list[tuple[str, Callable[[Method, Records], str]]] = []
    for group in GROUPS:
        for protocol in _protocols(group):
            cases = [case for case in group.cases if case.protocol == protocol]
            for points in group.points:
                heading = f"{protocol}, {TITLES[points].lower()}"
                columns.append((heading, _psnr_of(cases, points)))
            columns.append((f"{protocol}, paper", _papers_psnr(paper, protocol)))
    leaves = [record for record in records if record.run.case in GROUPS[0].cases]
    columns.append((f"CPU / {BASELINE.title}", _time_of(leaves, GROUPS[0].points[-1])))
    rows = []
    for method in METHODS:
        own = [record for record in records if record.run.method is method]
        if own:
            rows.append([method.title, *(cell(method, own) for _, cell in columns)])
    return markdown(["method", *(heading for heading, _ in columns)], rows)


def _psnr_of(cases: Sequence[Case], points: Points) -> Callable[[Method, Records], str]:
    def cell(method: Method, own: Records) -> str:
        shown = [record for record in own if record.run.points == points]
        by_scene = [[r for r in shown if r.run.case is case] for case in cases]
        return mean_over_scenes(by_scene, score_of("psnr"), ".2f") if all(by_scene) else NONE

    return cell


def _papers_psnr(paper: PaperTables, protocol: str) -> Callable[[Method, Records], str]:
    return lambda method, _: _numbers(paper, protocol, method, 1)[0]


def _time_of(leaves: Records, points: Points) -> Callable[[Method, Records], str]:
    def cell(method: Method, _: Records) -> str:
        own, baseline = (
            [r for r in leaves if r.run.points == points and r.run.method is one]
            for one in (method, BASELINE)
        )
        return NONE if method is BASELINE else time_ratio(own, baseline)

    return cell


def tables(records: Records, planned: int) -> str:
    """Return a table for each group and choice of first points, with notes, in Markdown."""
    paper = paper_tables(PAPER)
    parts = []
    for group in GROUPS:
        for points in group.points:
            shown = [r for r in records if r.run.points == points and r.run.case in group.cases]
            if shown:
                title = f"{TITLES[points]} {group.title}".rstrip()
                parts += [f"## {title}\n", _table(group, shown, paper)]
    notes = " ".join(paper.notes)
    parts.append(NOTES.format(source=paper.source, notes=notes, count=count(records, planned)))
    return "\n".join(parts)


def _table(group: Group, records: Records, paper: PaperTables) -> str:
    scenes = [case.data for case in group.cases]
    machine = commonest_processor(records)
    several = len({record.processor for record in records}) > 1
    scores = scores_shown(records)
    headings = ["method", "seeds", *scenes, "mean", "to 3DGS", *scores.values(), "Gaussians"]
    headings += [f"CPU s, {machine}" if several else "CPU s", f"CPU / {BASELINE.title}", "MB"]
    headings += _papers_columns(group, paper)
    baseline = [record for record in records if record.run.method is BASELINE]
    rows = []
    for method in METHODS:
        own = [record for record in records if record.run.method is method]
        if own:
            cells = _cells(group.cases, own, baseline, list(scores), machine)
            rows.append([method.title, *cells, *_published(group, method, paper)])
    return markdown(headings, rows)


def _cells(
    cases: Sequence[Case],
    own: Records,
    baseline: Records,
    scores: Sequence[str],
    machine: str,
) -> list[str]:
    by_scene = [[record for record in own if record.run.case is case] for case in cases]
    on_machine = [[r for r in records if r.processor == machine] for records in by_scene]
    is_baseline = own[0].run.method is BASELINE

    def mean(number: Callable[[Record], float | None], form: str) -> str:
        return mean_over_scenes(by_scene, number, form)

    return [
        " + ".join(str(len(records)) for records in by_scene),
        *(spread([record.scores["psnr"] for record in records]) for records in by_scene),
        mean(score_of("psnr"), ".2f") if all(by_scene) else NONE,
        NONE if is_baseline else gain(own, baseline),
        *(mean(score_of(name), ".3f") for name in scores),
        mean(lambda record: record.measured["gaussians"], ",.0f"),
        mean_over_scenes(on_machine, cpu_seconds, ",.0f"),
        NONE if is_baseline else time_ratio(own, baseline),
        mean(lambda record: record.measured["peak_memory_mb"], ",.0f"),
    ]


def _protocols(group: Group) -> list[str]:
    return list(dict.fromkeys(case.protocol for case in group.cases))


def _papers_columns(group: Group, paper: PaperTables) -> list[str]:
    """All of a paper's metrics for one protocol; for several protocols the first metric of each."""
    protocols = _protocols(group)
    if len(protocols) == 1:
        first, *others = [metric.upper() for metric in paper.metrics]
        return [f"paper: {first}", *others]
    return [f"paper: {name}" for name in protocols]


def _published(group: Group, method: Method, paper: PaperTables) -> list[str]:
    protocols = _protocols(group)
    metrics = len(paper.metrics) if len(protocols) == 1 else 1
    return [cell for name in protocols for cell in _numbers(paper, name, method, metrics)]


def _numbers(paper: PaperTables, protocol: str, method: Method, metrics: int) -> list[str]:
    """The paper's first metrics of a method by a protocol."""
    numbers = paper.results[protocol].get(method.paper) if method.paper else None
    return [
        NONE if numbers is None else format(numbers[index], ".2f" if name == "psnr" else ".3f")
        for index, name in enumerate(paper.metrics[:metrics])
    ]
