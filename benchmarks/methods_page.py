"""The records of `benchmarks.methods` as tables, beside what papers report."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from benchmarks.methods_plan import (
    BASELINE,
    METHODS,
    PROTOCOL,
    SCENES,
    SEEDS,
    Method,
    MethodRun,
    Points,
)
from benchmarks.paired import NONE, difference, spread
from benchmarks.training_records import Record
from registry.comparing.paper_tables import PaperTables, paper_tables

BEGIN = "<!-- measured: `make methods` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
PAPER = "stereogs"
TITLES: dict[Points, str] = {"own": "Own points", "same": "Same points"}
NOTES = """\
PSNR is over a scene's test views, ± the sample standard deviation over seeds where there are several;
*both* is the mean over the two scenes, and what follows over those that a row has. *to 3DGS* is the mean
difference in PSNR to 3DGS in the same table, over pairs of the same scene and seed, with its 95 % interval
(Student's t) from three pairs on. *CPU s* is the processor time of loading, initialization and training, over
all threads, without scoring; nothing came from the cache of prior answers. *MB* is the most memory that the
process took until scoring. *paper* are averages over all eight LLFF scenes from {source}. {notes}
"""


def page_text(records: Sequence[Record[MethodRun]]) -> str:
    """The measured part of the page, in Markdown."""
    paper = paper_tables(PAPER)
    parts = []
    for points, title in TITLES.items():
        own = [record for record in records if record.run.points == points]
        if own:
            parts += [f"### {title}\n", _table(own, paper)]
    parts.append(NOTES.format(source=paper.source, notes=" ".join(paper.notes)))
    devices = dict.fromkeys(record.measured["device"]["name"] for record in records)
    planned = sum(len(method.points) for method in METHODS) * len(SCENES) * len(SEEDS)
    parts.append(
        f"{len(records)} of {planned} runs, on {' and '.join(devices) or 'no device yet'}.\n"
    )
    return "\n".join(parts)


def _table(records: Sequence[Record[MethodRun]], paper: PaperTables) -> str:
    headings = ["method", "seeds", *SCENES, "both", "to 3DGS", "SSIM", "LPIPS"]
    headings += ["Gaussians", "CPU s", "MB", "paper: PSNR", "SSIM", "LPIPS"]
    baseline = [record for record in records if record.run.method is BASELINE]
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)]]
    for method in METHODS:
        own = [record for record in records if record.run.method is method]
        if own:
            lines.append([method.title, *_cells(own, baseline), *_published(method, paper)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cells(own: Sequence[Record[MethodRun]], baseline: Sequence[Record[MethodRun]]) -> list[str]:
    by_scene = [[record for record in own if record.run.data == scene] for scene in SCENES]
    compared = None if own[0].run.method is BASELINE else difference(_psnr(own), _psnr(baseline))

    def mean(number: Callable[[Record[MethodRun]], float], form: str) -> str:
        means = [statistics.mean(map(number, records)) for records in by_scene if records]
        return format(statistics.mean(means), form)

    psnr = mean(lambda record: record.scores["psnr"], ".2f")
    return [
        " + ".join(str(len(records)) for records in by_scene),
        *(spread([record.scores["psnr"] for record in records]) for records in by_scene),
        psnr if all(by_scene) else NONE,
        NONE if compared is None else str(compared),
        mean(lambda record: record.scores["ssim"], ".3f"),
        mean(lambda record: record.scores["lpips"], ".3f"),
        mean(lambda record: record.measured["gaussians"], ",.0f"),
        mean(lambda record: record.measured["cpu_seconds"], ",.0f"),
        mean(lambda record: record.measured["peak_memory_mb"], ",.0f"),
    ]


def _psnr(records: Sequence[Record[MethodRun]]) -> dict[tuple[str, int], float]:
    return {(record.run.data, record.run.seed): record.scores["psnr"] for record in records}


def _published(method: Method, paper: PaperTables) -> list[str]:
    numbers = paper.results[PROTOCOL].get(method.paper) if method.paper else None
    if numbers is None:
        return [NONE] * len(paper.metrics)
    forms = {"psnr": ".2f"}
    named = zip(paper.metrics, numbers, strict=True)
    return [format(number, forms.get(name, ".3f")) for name, number in named]
