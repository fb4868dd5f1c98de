"""The records of `benchmarks.methods` as tables, beside what papers report."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scipy.stats import t as student

from benchmarks.methods_plan import BASELINE, METHODS, PROTOCOL, SCENES, SEEDS, Method, Points
from benchmarks.methods_records import Record
from registry.comparing.paper_tables import PaperTables, paper_tables

BEGIN = "<!-- measured: `make methods` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
PAPER = "stereogs"
ENOUGH_PAIRS = 3
"""Pairs from which on a difference has an interval."""
CONFIDENCE = 0.95
NONE = "\u2013"
TITLES: dict[Points, str] = {"own": "Own points", "same": "Same points"}
NOTES = """\
PSNR is over a scene's test views, ± the sample standard deviation over seeds where there are several;
*both* is the mean over the two scenes, and what follows over those that a row has. *to 3DGS* is the mean
difference in PSNR to 3DGS in the same table, over pairs of the same scene and seed, with its 95 % interval
(Student's t) from three pairs on. *CPU s* is the processor time of loading, initialization and training, over
all threads, without scoring; nothing came from the cache of prior answers. *MB* is the most memory that the
process took until scoring. *paper* are averages over all eight LLFF scenes from {source}. {notes}
"""


@dataclass(frozen=True)
class Difference:
    """How far a method is from the baseline, in dB.

    Args:
        mean: over the pairs.
        half: half the width of its interval; None with too few pairs.
    """

    mean: float
    half: float | None

    def __str__(self) -> str:
        return f"{self.mean:+.2f}" + ("" if self.half is None else f" ± {self.half:.2f}")


def difference(records: Sequence[Record], baseline: Sequence[Record]) -> Difference | None:
    """The mean difference in PSNR over pairs of the same scene and seed; None without a pair."""
    known = {(record.run.data, record.run.seed): record.scores["psnr"] for record in baseline}
    pairs = [
        record.scores["psnr"] - known[key]
        for record in records
        if (key := (record.run.data, record.run.seed)) in known
    ]
    if not pairs:
        return None
    mean, count = statistics.mean(pairs), len(pairs)
    if count < ENOUGH_PAIRS:
        return Difference(mean, None)
    quantile = float(student.ppf((1 + CONFIDENCE) / 2, count - 1))
    return Difference(mean, quantile * statistics.stdev(pairs) / math.sqrt(count))


def page_text(records: Sequence[Record]) -> str:
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


def _table(records: Sequence[Record], paper: PaperTables) -> str:
    headings = ["method", "seeds", *SCENES, "both", "to 3DGS", "SSIM", "LPIPS"]
    headings += ["Gaussians", "CPU s", "MB", "paper: PSNR", "SSIM", "LPIPS"]
    baseline = [record for record in records if record.run.method is BASELINE]
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)]]
    for method in METHODS:
        own = [record for record in records if record.run.method is method]
        if own:
            lines.append([method.title, *_cells(own, baseline), *_published(method, paper)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cells(own: Sequence[Record], baseline: Sequence[Record]) -> list[str]:
    by_scene = [[record for record in own if record.run.data == scene] for scene in SCENES]
    compared = difference(own, baseline) if own[0].run.method is not BASELINE else None

    def mean(number: Callable[[Record], float], form: str) -> str:
        means = [statistics.mean(map(number, records)) for records in by_scene if records]
        return format(statistics.mean(means), form)

    psnr = mean(lambda record: record.scores["psnr"], ".2f")
    return [
        " + ".join(str(len(records)) for records in by_scene),
        *(_spread([record.scores["psnr"] for record in records]) for records in by_scene),
        psnr if all(by_scene) else NONE,
        NONE if compared is None else str(compared),
        mean(lambda record: record.scores["ssim"], ".3f"),
        mean(lambda record: record.scores["lpips"], ".3f"),
        mean(lambda record: record.measured["gaussians"], ",.0f"),
        mean(lambda record: record.measured["cpu_seconds"], ",.0f"),
        mean(lambda record: record.measured["peak_memory_mb"], ",.0f"),
    ]


def _spread(values: Sequence[float]) -> str:
    if not values:
        return NONE
    mean = f"{statistics.mean(values):.2f}"
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):.2f}"


def _published(method: Method, paper: PaperTables) -> list[str]:
    numbers = paper.results[PROTOCOL].get(method.paper) if method.paper else None
    if numbers is None:
        return [NONE] * len(paper.metrics)
    forms = {"psnr": ".2f"}
    named = zip(paper.metrics, numbers, strict=True)
    return [format(number, forms.get(name, ".3f")) for name, number in named]
