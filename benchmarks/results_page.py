"""What `benchmarks.results` measured, as a table; keeps what people wrote around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.marked_page import rewrite
from benchmarks.results_picture import draw
from benchmarks.results_plan import Case, Measurement, Method
from registry.ablation.running.folder import AblationFolder
from registry.comparing.comparability import check_comparable
from registry.comparing.comparison import FinishedRun, read_run
from registry.system.files import write_text

Key = TypeVar("Key")

PAGE = "results.md"
BEGIN = "<!-- measured: `make results` rewrites everything from here to the end mark -->"
END = "<!-- measured: end; what stands outside the marks is kept -->"
NEW_PAGE = f"# Measured on photographs\n\n{BEGIN}\n{END}\n"

NOTES = """\
Each column comes once for each pipeline: {methods}. PSNR and SSIM (with the Gaussian window) are means over
the test views, which training never saw. *seconds* are initialization and training together, without
loading and scoring; nothing came from the cache of prior answers, and one run was at work at a time. *MB* is
the most memory that the process took, scoring included. A **mean** is over the data sets that follow one
protocol.

`make results` also draws the first test view of each row, truth beside {order}, into
`benchmarks/out/results/results.jpg`: the photographs are the data sets' own and not ours to publish.

## How it was measured

Every row follows its [protocol](protocols.md): which photographs train and test, their size, background
and masks.
"""


@dataclass(frozen=True)
class Record:
    """A finished run and its place in the table."""

    case: Case
    method: Method
    run: FinishedRun

    @property
    def numbers(self) -> dict[str, float]:
        """The table's numbers; NaN where there is none."""
        results = self.run.results
        seconds = results["seconds"] + results["initialization"]["seconds"]
        memory = results["peak_memory_mb"]
        return {
            "PSNR": _score(self.run.scores.get("psnr")),
            "SSIM": _score(self.run.scores.get("ssim")),
            "Gaussians": float(results["gaussians"]),
            "seconds": float(seconds),
            "MB": _score(memory),
        }


FORMATS = {"PSNR": ".2f", "SSIM": ".3f", "Gaussians": ",.0f", "seconds": ",.0f", "MB": ",.0f"}
"""The table's columns."""


def read_records(measurements: Iterable[Measurement], folder: AblationFolder) -> list[Record]:
    """All runs; those that follow one protocol are checked to be comparable.

    Raises:
        RunError: a run is not finished, or two cannot be compared.
    """
    records = [Record(m.case, m.method, read_run(folder.run(m.run).path)) for m in measurements]
    for group in _by_protocol(records).values():
        check_comparable([record.run for record in group])
    return records


def draw_first_views(records: Sequence[Record], path: Path) -> None:
    """Write a picture of the first test view of each row: truth, then a render of each pipeline."""
    draw([(_label(row), [record.run for record in row]) for row in _rows(records)], path)


def write_page(records: Sequence[Record], page: Path) -> None:
    """Write the page's measured part; a page that is not there is begun.

    Raises:
        RunError: the page that is there lacks the marks.
    """
    if not page.is_file():
        write_text(page, NEW_PAGE)
    rewrite(page, BEGIN, END, page_text(records))


def page_text(records: Sequence[Record]) -> str:
    """The measured part of the page, in Markdown."""
    titles = [record.method.title for record in _rows(records)[0]]
    notes = NOTES.format(methods=", then ".join(titles), order=" and ".join(titles))
    facts = [_method_fact(records, title) for title in titles]
    facts += [_protocol_fact(name, group) for name, group in _by_protocol(records).items()]
    devices = dict.fromkeys(_device(record) for record in records)
    facts.append(f"Measured on {'; '.join(devices)}.")
    return f"{_table(records)}\n{notes}\n" + "".join(f"- {fact}\n" for fact in facts)


def _table(records: Sequence[Record]) -> str:
    rows = _rows(records)
    titles = [record.method.title for record in rows[0]]
    headings = ["data set", "views", *(f"{name} {title}" for name in FORMATS for title in titles)]
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)]]
    lines += [
        [row[0].case.data, str(row[0].case.views), *_cells([[r] for r in row])] for row in rows
    ]
    for protocol, group in _by_protocol(records).items():
        if len(_rows(group)) > 1:
            methods = [[r for r in group if r.method.title == title] for title in titles]
            views = str(group[0].case.views)
            bold = [f"**{cell}**" for cell in _cells(methods)]
            lines.append([f"**mean of {protocol}**", views, *bold])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cells(methods: Sequence[Sequence[Record]]) -> list[str]:
    """Each column's mean over each method's records, columns outside, methods inside."""
    cells = []
    for name, form in FORMATS.items():
        for records in methods:
            values = [record.numbers[name] for record in records]
            mean = sum(values) / len(values)
            cells.append("\u2013" if math.isnan(mean) else format(mean, form))
    return cells


def _method_fact(records: Sequence[Record], title: str) -> str:
    own = [record for record in records if record.method.title == title]
    iterations = sorted({record.run.results["iterations"] for record in own})
    starts = _grouped(own, lambda record: record.run.results["initialization"]["initializer"])
    usual, *others = sorted(starts, key=lambda name: -len(starts[name]))
    said = f"`{usual}`"
    for name in others:
        said += f", but by `{name}` on {', '.join(_cases(starts[name]))}"
    file = own[0].method.file
    return (
        f"*{title}* is `{file.parent.name}/{file.name}`, {', '.join(map(str, iterations))} iterations, "
        f"initial points by {said}."
    )


def _protocol_fact(name: str, group: Sequence[Record]) -> str:
    record = group[0].run.results["protocol"]
    scenes = list(dict.fromkeys(r.run.scene for r in group))
    first = group[0].run.results
    size = first["scene"]
    text = (
        f"`{name}`: {', '.join(scenes)} at {size['width']}x{size['height']}, "
        f"{len(first['views']['test'])} test views in {scenes[0]}"
    )
    if record is None:
        return f"{text}; no protocol."
    published = [scene for scene in scenes if scene.split("_", 1)[-1] in record["scenes"]]
    masks = f"; {record['masks']}" if record["masks"] else ""
    return (
        f"{text}{masks}. Scenes that published averages go over: {len(record['scenes'])}; of these "
        f"here: {len(published)}."
    )


def _device(record: Record) -> str:
    device: dict[str, Any] = record.run.results["device"]
    return f"{device['name']} ({device['platform']})"


def _score(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _label(row: Sequence[Record]) -> str:
    return f"{row[0].case.data}, {row[0].case.views} views"


def _cases(records: Iterable[Record]) -> list[str]:
    return [f"{record.case.data} ({record.case.views})" for record in records]


def _rows(records: Iterable[Record]) -> list[list[Record]]:
    """Records by case, in order; a row's methods keep their order."""
    return list(_grouped(records, lambda record: (record.case.data, record.case.views)).values())


def _by_protocol(records: Iterable[Record]) -> dict[str, list[Record]]:
    return _grouped(records, lambda record: record.run.protocol or record.run.scene)


def _grouped(records: Iterable[Record], key: Callable[[Record], Key]) -> dict[Key, list[Record]]:
    groups: dict[Key, list[Record]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return groups
