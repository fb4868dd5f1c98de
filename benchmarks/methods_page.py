"""The records of `benchmarks.methods` as tables, beside what papers report."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from benchmarks.methods_plan import BASELINE, GROUPS, METHODS, Group, Method, MethodRun, Points
from benchmarks.results_plan import Case
from benchmarks.scores import mean_over_scenes, score_of, scores_shown
from benchmarks.spread import NONE, spread
from benchmarks.times import commonest_processor, cpu_seconds, time_ratio
from benchmarks.training_records import Record, processor
from stereogs_plugins.tools.experiments.comparing.paper_tables import PaperTables, paper_tables
from stereogs_plugins.tools.experiments.showing.paired import difference

BEGIN = "<!-- measured: `make methods` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
PAPER = "stereogs"
TITLES: dict[Points, str] = {"own": "Own points", "same": "Same points"}
NOTES = """\
PSNR is over a scene's test views, ± the sample standard deviation over seeds where there are several;
*mean* is over the scenes, and what follows over those that a row has. *to 3DGS* is the mean
difference in PSNR to 3DGS in the same table, over pairs of the same scene and seed, with its 95 % interval
(Student's t) from three pairs on. LPIPS is by VGG, and AVGE with it; by AlexNet over the runs that
measured it. *CPU s* is the processor time of loading, initialization and training, over all threads,
without scoring, over the runs on the machine that most runs of the table were made on; nothing came from
the cache of prior answers. *CPU / 3DGS* is how many times 3DGS's that is, over the scenes and machines
that both were trained on. *MB* is the most memory that the process took until scoring.
*paper* are averages over all scenes of a data set from {source}. {notes}
"""


def page_text(records: Sequence[Record[MethodRun]], planned: int) -> str:
    """The measured part of the page, in Markdown."""
    paper = paper_tables(PAPER)
    parts = []
    for group in GROUPS:
        for points in group.points:
            shown = [r for r in records if r.run.points == points and r.run.case in group.cases]
            if shown:
                title = f"{TITLES[points]} {group.title}".rstrip()
                parts += [f"### {title}\n", _table(group, shown, paper)]
    parts.append(NOTES.format(source=paper.source, notes=" ".join(paper.notes)))
    devices = " and ".join(_devices(records)) or "no device yet"
    parts.append(f"{len(records)} of {planned} runs, on {devices}.\n")
    return "\n".join(parts)


def _table(group: Group, records: Sequence[Record[MethodRun]], paper: PaperTables) -> str:
    scenes = [case.data for case in group.cases]
    machine = commonest_processor(records)
    several = len(_devices(records)) > 1
    scores = scores_shown(records)
    headings = ["method", "seeds", *scenes, "mean", "to 3DGS", *scores.values(), "Gaussians"]
    headings += [f"CPU s, {machine}" if several else "CPU s", f"CPU / {BASELINE.title}", "MB"]
    headings += _papers_columns(group, paper)
    baseline = [record for record in records if record.run.method is BASELINE]
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)]]
    for method in METHODS:
        own = [record for record in records if record.run.method is method]
        if own:
            cells = _cells(group.cases, own, baseline, list(scores), machine)
            lines.append([method.title, *cells, *_published(group, method, paper)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cells(
    cases: Sequence[Case],
    own: Sequence[Record[MethodRun]],
    baseline: Sequence[Record[MethodRun]],
    scores: Sequence[str],
    machine: str,
) -> list[str]:
    by_scene = [[record for record in own if record.run.case is case] for case in cases]
    on_machine = [[r for r in records if processor(r) == machine] for records in by_scene]
    is_baseline = own[0].run.method is BASELINE
    compared = None if is_baseline else difference(_psnr(own), _psnr(baseline))

    def mean(number: Callable[[Record[MethodRun]], float | None], form: str) -> str:
        return mean_over_scenes(by_scene, number, form)

    psnr = mean(score_of("psnr"), ".2f")
    return [
        " + ".join(str(len(records)) for records in by_scene),
        *(spread([record.scores["psnr"] for record in records]) for records in by_scene),
        psnr if all(by_scene) else NONE,
        NONE if compared is None else compared.text(),
        *(mean(score_of(name), ".3f") for name in scores),
        mean(lambda record: record.measured["gaussians"], ",.0f"),
        mean_over_scenes(on_machine, cpu_seconds, ",.0f"),
        NONE if is_baseline else time_ratio(own, baseline),
        mean(lambda record: record.measured["peak_memory_mb"], ",.0f"),
    ]


def _devices(records: Sequence[Record[MethodRun]]) -> list[str]:
    return list(dict.fromkeys(map(processor, records)))


def _psnr(records: Sequence[Record[MethodRun]]) -> dict[tuple[str, int], float]:
    return {(record.run.case.data, record.run.seed): record.scores["psnr"] for record in records}


def _protocols(group: Group) -> list[str]:
    return list(dict.fromkeys(case.protocol for case in group.cases))


def _papers_columns(group: Group, paper: PaperTables) -> list[str]:
    """All of a paper's metrics by one protocol, of several protocols the first metric by each."""
    protocols = _protocols(group)
    if len(protocols) == 1:
        first, *others = [metric.upper() for metric in paper.metrics]
        return [f"paper: {first}", *others]
    return [f"paper: {name}" for name in protocols]


def _published(group: Group, method: Method, paper: PaperTables) -> list[str]:
    protocols = _protocols(group)
    metrics = paper.metrics if len(protocols) == 1 else paper.metrics[:1]
    cells = []
    for protocol in protocols:
        numbers = paper.results[protocol].get(method.paper) if method.paper else None
        for index, name in enumerate(metrics):
            form = ".2f" if name == "psnr" else ".3f"
            cells.append(NONE if numbers is None else format(numbers[index], form))
    return cells
