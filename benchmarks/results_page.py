"""What `benchmarks.results` measured, as tables; keeps what people wrote around them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

from benchmarks.results_plan import Measurement, Method
from benchmarks.scores import scores_shown
from benchmarks.spread import NONE, spread
from benchmarks.training_records import Record as AnyRecord
from benchmarks.training_records import processor
from stereogs_plugins.tools.experiments.showing.paired import difference

Record = AnyRecord[Measurement]
Records = Sequence[Record]
Key = TypeVar("Key", bound=Hashable)
Cells = Callable[[Records, Method], str]
"""What a table says of a row's records, by method."""

BEGIN = "<!-- measured: `make results` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
NOTES = """\
Scores are means over the test views, which training never saw; ± is the sample standard deviation over
seeds. *to plain* is the mean difference over pairs of the same scene and seed, with its 95 % interval
(Student's t) from three pairs on. SSIM has the Gaussian window; LPIPS (VGG unless it says Alex), and AVGE
with it, are of seed 0 alone, as they take longer than a short training. *CPU s* is the processor time of
loading, initialization and training over all threads, without scoring; nothing came from the cache of
prior answers. *MB* is the most memory that the process took until scoring.
A **mean** is over the data sets that follow one protocol.

`make results` also draws the first test view of each row, truth beside {order}, into
`benchmarks/out/results/results.jpg`: the photographs are the data sets' own and not ours to publish.

## How it was measured

Every row follows its [protocol](protocols.md): which photographs train and test, their size, background
and masks.

"""


def page_text(records: Records, planned: int) -> str:
    """The measured part of the page, in Markdown; whatever is there of it."""
    titles = [method.title for method in _methods(records)]
    facts = [_method_fact(records, method) for method in _methods(records)]
    facts += [_protocol_fact(name, group) for name, group in by_protocol(records).items()]
    devices = dict.fromkeys(processor(record) for record in records)
    facts.append(
        f"{len(records)} of {planned} runs, on {' and '.join(devices) or 'no device yet'}."
    )
    seen = {name: heading for name, heading in scores_shown(records).items() if name != "ssim"}
    return "\n".join(
        (
            "### Colours\n",
            _table(records, ["PSNR", "to plain", "SSIM"], [_psnr, _to_plain, _mean_of("ssim")]),
            "### What people see, and what it costs\n",
            _table(
                records,
                [*seen.values(), "Gaussians", "CPU s", "MB"],
                [*map(_mean_of, seen), *(_mean_of(*column) for column in _COSTS)],
            ),
            NOTES.format(order=" and ".join(titles)) + "".join(f"- {fact}\n" for fact in facts),
        )
    )


_COSTS = (("gaussians", ",.0f"), ("cpu_seconds", ",.0f"), ("peak_memory_mb", ",.0f"))


def _table(records: Records, names: Sequence[str], columns: Sequence[Cells]) -> str:
    shown = [
        (f"{name} {method.title}", method, cells)
        for name, cells in zip(names, columns, strict=True)
        for method in _methods(records)
        if not (cells is _to_plain and method.baseline)
    ]
    headings = ["data set", "views", "seeds", *(heading for heading, _, _ in shown)]
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)]]
    for row in by_case(records):
        case = row[0].run.case
        cells = [cells(row, method) for _, method, cells in shown]
        lines.append([case.data, str(case.views), _seeds(row), *cells])
    for protocol, group in by_protocol(records).items():
        if len(by_case(group)) > 1:
            cells = [f"**{cells(group, method)}**" for _, method, cells in shown]
            lines.append([f"**mean of {protocol}**", str(group[0].run.case.views), "", *cells])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _psnr(records: Records, method: Method) -> str:
    if len(by_case(records)) > 1:  # the spread over seeds is a data set's
        return _mean_of("psnr", ".2f")(records, method)
    return spread([record.scores["psnr"] for record in records if record.run.method is method])


def _to_plain(records: Records, method: Method) -> str:
    psnr = {
        plain: {
            (record.run.case, record.run.seed): record.scores["psnr"]
            for record in records
            if (record.run.method.baseline if plain else record.run.method is method)
        }
        for plain in (False, True)
    }
    found = difference(psnr[False], psnr[True])
    return NONE if found is None else found.text()


def _mean_of(name: str, form: str = ".3f") -> Cells:
    """The mean over data sets of the mean over seeds; nothing where a data set has none."""

    def cells(records: Records, method: Method) -> str:
        means = []
        for row in by_case(records):
            numbers = [record.scores | record.measured for record in row]
            values = [
                found[name]
                for record, found in zip(row, numbers, strict=True)
                if record.run.method is method and found.get(name) is not None
            ]
            if not values:
                return NONE
            means.append(statistics.mean(values))
        return format(statistics.mean(means), form)

    return cells


def _seeds(row: Records) -> str:
    """How many of each method, once if they are equally many."""
    counts = [sum(record.run.method is method for record in row) for method in _methods(row)]
    return str(counts[0]) if len(set(counts)) == 1 else " + ".join(map(str, counts))


def _method_fact(records: Records, method: Method) -> str:
    own = [record for record in records if record.run.method is method]
    iterations = sorted({record.measured["iterations"] for record in own})
    starts = grouped(own, lambda record: record.run.pipeline.one("initializer").host.use)
    usual, *others = sorted(starts, key=lambda name: -len(starts[name]))
    said = f"`{usual}`"
    for name in others:
        cases = dict.fromkeys(f"{r.run.case.data} ({r.run.case.views})" for r in starts[name])
        said += f", but by `{name}` on {', '.join(cases)}"
    return (
        f"*{method.title}* is `{method.file.parent.name}/{method.file.name}`, "
        f"{', '.join(map(str, iterations))} iterations, initial points by {said}."
    )


def _protocol_fact(name: str, group: Records) -> str:
    first = group[0]
    scenes = list(dict.fromkeys(record.run.case.data for record in group))
    width, height = first.measured["size"]
    text = (
        f"`{name}`: {', '.join(scenes)} at {width}x{height}, {len(first.measured['views'])} test views in "
        f"{first.run.case.data}"
    )
    applied = first.run.pipeline.protocol
    if applied is None:
        return f"{text}; no protocol."
    protocol = applied.protocol
    published = [scene for scene in scenes if scene.split("_", 1)[-1] in protocol.scenes]
    changed = f" ({', '.join(applied.modified)} of our own)" if applied.modified else ""
    masks = f"; {protocol.masks}" if protocol.masks else ""
    return (
        f"{text}{changed}{masks}. Scenes that published averages go over: {len(protocol.scenes)}; of "
        f"these here: {len(published)}."
    )


def _methods(records: Records) -> list[Method]:
    return list(dict.fromkeys(record.run.method for record in records))


def by_case(records: Iterable[Record]) -> list[list[Record]]:
    """Records by data set and number of training views, in order."""
    return list(grouped(records, lambda record: record.run.case).values())


def by_protocol(records: Iterable[Record]) -> dict[str, list[Record]]:
    """Records by the name of their protocol; those that follow none by data set and number of views."""

    def name(record: Record) -> str:
        case = record.run.case
        return case.protocol or f"{case.data}-{case.views}"

    return grouped(records, name)


def grouped(records: Iterable[Record], key: Callable[[Record], Key]) -> dict[Key, list[Record]]:
    """Records by a key, in order."""
    groups: dict[Key, list[Record]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return groups
