"""The records of `benchmarks.results_plan` as tables."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

from benchmarks.cells import NONE, count, gain, scores_shown, spread
from benchmarks.records import Record as AnyRecord
from benchmarks.trainings import Method, Training
from benchmarks.view_angles import recorded
from stereogs.experiments.showing.score_table import markdown

Record = AnyRecord[Training]
Records = Sequence[Record]
Key = TypeVar("Key", bound=Hashable)
Cells = Callable[[Records, Method], str]
"""Makes the cell of a method from a row's records."""

NOTES = """\
Columns are defined in [results](../../docs/results.md#columns). *to plain* is the gain over *plain*. A test
view is *inside* if it looks from between training cameras: its direction from the subject is at most 2°
outside the cone of theirs. *nearest* is the median angle from a test view to the nearest training view, as
seen from the subject (`python -m benchmarks.view_angles`). LPIPS and AVGE are of seed 0 only, as they take
longer than a short training. A **mean** is over the data sets of one protocol.

`make results` also draws the first test view of each row, the photograph next to the renders, into
`benchmarks/out/results/results.jpg`; the photographs belong to the data sets and are not published here.

## Setup

Every row follows its [protocol](../../docs/protocols.md): training and test photographs, image size,
background and masks.

"""
INSIDE = 2.0
"""Largest angle in degrees to the cone of the training cameras of a view that counts as interpolated."""
_COSTS = (("gaussians", ",.0f"), ("cpu_seconds", ",.0f"), ("peak_memory_mb", ",.0f"))


def summary(records: Records) -> str:
    """Return one table with a row for each protocol: PSNR, LPIPS and CPU seconds."""
    columns = [("PSNR", _mean_of("psnr", ".2f")), ("LPIPS", _mean_of("lpips"))]
    columns.append(("CPU s", _mean_of("cpu_seconds", ",.0f")))
    methods = _methods(records)
    headings = [f"{name} {method.title}" for name, _ in columns for method in methods]
    rows = [
        [name, *(cells(group, method) for _, cells in columns for method in methods)]
        for name, group in by_protocol(records).items()
    ]
    return markdown(["protocol", *headings], rows)


def tables(records: Records, planned: int) -> str:
    """Return tables with a row for each data set and number of views, with notes, in Markdown."""
    facts = [_method_fact(records, method) for method in _methods(records)]
    facts += [_protocol_fact(name, group) for name, group in by_protocol(records).items()]
    facts.append(count(records, planned))
    shown = {name: heading for name, heading in scores_shown(records).items() if name != "ssim"}
    return "\n".join(
        (
            "## PSNR and SSIM\n",
            _table(records, ["PSNR", "to plain", "SSIM"], [_psnr, _to_plain, _mean_of("ssim")]),
            "## Perceptual scores and costs\n",
            _table(
                records,
                [*shown.values(), "Gaussians", "CPU s", "MB"],
                [*map(_mean_of, shown), *(_mean_of(*column) for column in _COSTS)],
            ),
            "## Interpolation and extrapolation\n",
            _by_angle(records),
            NOTES + "".join(f"- {fact}\n" for fact in facts),
        )
    )


def _table(records: Records, names: Sequence[str], columns: Sequence[Cells]) -> str:
    shown = [
        (f"{name} {method.title}", method, cells)
        for name, cells in zip(names, columns, strict=True)
        for method in _methods(records)
        if not (cells is _to_plain and method.baseline)
    ]
    headings = ["data set", "views", "seeds", *(heading for heading, _, _ in shown)]
    lines = []
    for row in by_case(records):
        case = row[0].run.case
        cells = [cells(row, method) for _, method, cells in shown]
        lines.append([case.data, str(case.views), _seeds(row), *cells])
    for protocol, group in by_protocol(records).items():
        if len(by_case(group)) > 1:
            cells = [f"**{cells(group, method)}**" for _, method, cells in shown]
            lines.append([f"**mean of {protocol}**", str(group[0].run.case.views), "", *cells])
    return markdown(headings, lines)


def _by_angle(records: Records) -> str:
    """Return the PSNR of interpolated and of extrapolated test views, with the angles of each data set."""
    known, methods = recorded(), _methods(records)
    headings = ["data set", "views", "nearest", "inside", "outside"]
    headings += [f"{kind} {method.title}" for kind in ("inside", "outside") for method in methods]
    lines = []
    for row in by_case(records):
        case = row[0].run.case
        angles = known.get(f"{case.data}-{case.views}")
        if angles is None:  # not measured by `benchmarks.view_angles`
            continue
        groups = [
            {view for view, angle in angles.items() if (angle.outside <= INSIDE) == inside}
            for inside in (True, False)
        ]
        nearest = statistics.median(angle.nearest for angle in angles.values())
        cells = [_psnr_of(row, method, views) for views in groups for method in methods]
        counts = [str(len(views)) for views in groups]
        lines.append([case.data, str(case.views), f"{nearest:.1f}°", *counts, *cells])
    return markdown(headings, lines)


def _psnr_of(records: Records, method: Method, views: set[str]) -> str:
    """The mean over records of the method of their mean PSNR over some views."""
    own = [record for record in records if record.run.method is method]
    means = [statistics.mean(r.measured["views"][v]["psnr"] for v in views) for r in own if views]
    return format(statistics.mean(means), ".2f") if means else NONE


def _psnr(records: Records, method: Method) -> str:
    if len(by_case(records)) > 1:  # a spread over seeds needs a single data set
        return _mean_of("psnr", ".2f")(records, method)
    return spread([record.scores["psnr"] for record in records if record.run.method is method])


def _to_plain(records: Records, method: Method) -> str:
    own = [record for record in records if record.run.method is method]
    return gain(own, [record for record in records if record.run.method.baseline])


def _mean_of(name: str, form: str = ".3f") -> Cells:
    """The mean over data sets of the mean over seeds; `NONE` if a data set lacks the number."""

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
    """Number of records of each method, or one number if all are equal."""
    counts = [sum(record.run.method is method for record in row) for method in _methods(row)]
    return str(counts[0]) if len(set(counts)) == 1 else " + ".join(map(str, counts))


def _method_fact(records: Records, method: Method) -> str:
    own = [record for record in records if record.run.method is method]
    iterations = sorted({record.measured["iterations"] for record in own})
    starts = grouped(own, lambda record: record.run.pipeline.one("initializer").host.use)
    usual, *others = sorted(starts, key=lambda name: -len(starts[name]))
    text = f"`{usual}`"
    for name in others:
        cases = dict.fromkeys(f"{r.run.case.data} ({r.run.case.views})" for r in starts[name])
        text += f", but by `{name}` on {', '.join(cases)}"
    return (
        f"*{method.title}* is `{method.file.parent.name}/{method.file.name}`, "
        f"{', '.join(map(str, iterations))} iterations, initial points by {text}."
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
    changed = f" ({', '.join(applied.modified)} modified)" if applied.modified else ""
    masks = f"; {protocol.masks}" if protocol.masks else ""
    return (
        f"{text}{changed}{masks}. Scenes of published averages: {len(protocol.scenes)}; of these here: "
        f"{len(published)}."
    )


def _methods(records: Records) -> list[Method]:
    return list(dict.fromkeys(record.run.method for record in records))


def by_case(records: Iterable[Record]) -> list[list[Record]]:
    """Records by data set and number of training views, in order."""
    return list(grouped(records, lambda record: record.run.case).values())


def by_protocol(records: Iterable[Record]) -> dict[str, list[Record]]:
    """Records by the name of their protocol, or by data set and number of views if they follow none."""

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
