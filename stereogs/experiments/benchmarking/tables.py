"""The tables of a benchmark."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from typing import Any

from registry.toolkit.web_page import Cell

from ..showing.score_table import ScoreTable, csv_text
from ..showing.scores import NONE, difference
from .description import Benchmark, Trial
from .keeping import Records

SHOWN = ("psnr", "ssim", "lpips")
"""Metrics with a budget table, the first one with differences."""
END = "end"
_LOWER_IS_BETTER = ("lpips",)
_DECIMALS = {"psnr": 2}
_COSTS = {
    "seconds": "wall s",
    "cpu_seconds": "CPU s",
    "peak_memory_mb": "peak MB",
    "gaussians": "Gaussians",
}


def tables(benchmark: Benchmark, records: Records) -> list[ScoreTable]:
    """Return budget tables, differences, noise floor and costs.

    A number is the mean over scenes of the means over seeds. It is missing if a trial is missing, or has no
    complete state or no score.
    """
    found = [_budget_table(benchmark, records, metric) for metric in _metrics(records)]
    found += [_differences(benchmark, records)] if len(benchmark.entrants) > 1 else []
    return [*found, _noise(benchmark, records), _costs(benchmark, records)]


def _metrics(records: Records) -> list[str]:
    names = {name for record in records.values() for name in record["end"]["test"]}
    return [name for name in SHOWN if name in names]


def columns(benchmark: Benchmark) -> list[str]:
    """Return the keys of the budgets, and the end."""
    return [*(f"{budget:g}" for budget in benchmark.budgets), END]


def state_at(record: dict[str, Any], column: str) -> dict[str, Any] | None:
    """Return seconds and scores of the state at a budget, or at the end; None if none was complete."""
    found: dict[str, Any] | None = record[END] if column == END else record["budgets"].get(column)
    return found


def _scores(
    benchmark: Benchmark, records: Records, entrant: str, metric: str, column: str
) -> dict[tuple[str, int], float]:
    """Return the scores of the first trial of each scene and seed; none if one is missing."""
    scores = {}
    for trial in benchmark.trials:
        if trial.entrant == entrant and not trial.repeat:
            state = state_at(records[trial], column) if trial in records else None
            score = None if state is None else state["test"].get(metric)
            if score is None:
                return {}
            scores[trial.scene, trial.seed] = float(score)
    return scores


def _budget_table(benchmark: Benchmark, records: Records, metric: str) -> ScoreTable:
    decimals, lower = _DECIMALS.get(metric, 3), metric in _LOWER_IS_BETTER
    cells: dict[str, list[float | None]] = {entrant: [] for entrant in benchmark.entrants}
    for column in columns(benchmark):
        for entrant, row in cells.items():
            found = _scores(benchmark, records, entrant, metric, column)
            row.append(statistics.fmean(found.values()) if found else None)
    best = []
    for column_cells in zip(*cells.values(), strict=True):
        known = [n for n in column_cells if n is not None]
        best.append((min(known) if lower else max(known)) if len(known) > 1 else None)
    rows = [
        [
            Cell(entrant),
            *(
                Cell(NONE if n is None else f"{n:.{decimals}f}", n is not None and n == top)
                for n, top in zip(row, best, strict=True)
            ),
        ]
        for entrant, row in cells.items()
    ]
    head = [f"{metric} {'↓' if lower else '↑'}", *_headings(benchmark)]
    reasons = (record[END]["unavailable"].get(metric) for record in records.values())
    notes = [f"{metric}: {reason}" for reason in dict.fromkeys(reasons) if reason]
    return ScoreTable(f"{metric} at equal time", head, 1, rows, notes)


def _headings(benchmark: Benchmark) -> list[str]:
    return [*(f"{budget:g} s" for budget in benchmark.budgets), END]


def _differences(benchmark: Benchmark, records: Records) -> ScoreTable:
    metric, first = SHOWN[0], benchmark.entrants[0]
    rows = []
    for entrant in benchmark.entrants[1:]:
        row = [Cell(entrant)]
        for column in columns(benchmark):
            own, baseline = (
                _scores(benchmark, records, name, metric, column) for name in (entrant, first)
            )
            found = difference(own, baseline)
            row.append(Cell(NONE if found is None else found.text()))
        rows.append(row)
    note = "± 95 % interval (Student's t) over pairs of equal scene and seed, from three pairs on"
    title = f"{metric}, difference to {first}"
    return ScoreTable(title, ["entrant", *_headings(benchmark)], 1, rows, [note])


def _noise(benchmark: Benchmark, records: Records) -> ScoreTable:
    """Return the largest difference among equal seeds, and the deviation over different ones, at the end."""
    metric, rows = SHOWN[0], []
    for entrant in benchmark.entrants:
        equal = [_spread(group) for group in _groups(benchmark, records, entrant, repeats=True)]
        seeds = [
            statistics.stdev(scores)
            for scores, _ in _groups(benchmark, records, entrant, repeats=False)
            if len(scores) > 1
        ]
        rows.append(
            [
                Cell(entrant),
                Cell(f"{max(x for x, _ in equal):.3f}" if equal else NONE),
                Cell(_answer([same for _, same in equal])),
                Cell(f"{statistics.fmean(seeds):.3f}" if seeds else NONE),
            ]
        )
    head = ["entrant", "equal seeds", "equal bits", "different seeds"]
    notes = [
        "equal seeds: largest difference on a scene; different seeds: standard deviation, mean over scenes",
        *(
            f"{trial.entrant} takes no seed: its different seeds are repetitions"
            for trial in benchmark.trials
            if not (trial.scene != benchmark.scenes[0] or trial.seed or trial.repeat)
            and records.get(trial, {}).get("takes_seed") is False
        ),
    ]
    return ScoreTable(f"noise floor of {metric} at the end", head, 1, rows, notes)


def _groups(
    benchmark: Benchmark, records: Records, entrant: str, *, repeats: bool
) -> Iterator[tuple[list[float], list[str | None]]]:
    """Yield scores and hashes of the repetitions, or of the seeds, of each scene, if there are several."""
    for scene in benchmark.scenes:
        group = [
            records[trial]
            for trial in benchmark.trials
            if (trial.entrant, trial.scene) == (entrant, scene)
            and not (trial.seed if repeats else trial.repeat)
            and trial in records
        ]
        scores = [record[END]["test"].get(SHOWN[0]) for record in group]
        if len(group) > 1 and None not in scores:
            yield scores, [record["hash"] for record in group]


def _spread(group: tuple[list[float], list[str | None]]) -> tuple[float, bool | None]:
    """Return the range of the scores, and whether all hashes are equal; None without hashes."""
    scores, hashes = group
    return max(scores) - min(scores), None if None in hashes else len({*hashes}) == 1


def _answer(equal: list[bool | None]) -> str:
    if not equal or None in equal:
        return NONE
    return "yes" if all(equal) else "no"


def _costs(benchmark: Benchmark, records: Records) -> ScoreTable:
    rows = []
    for entrant in benchmark.entrants:
        own = [record for trial, record in records.items() if trial.entrant == entrant]
        row = [Cell(entrant)]
        for key in _COSTS:
            values = [_cost(record, key) for record in own]
            known = [value for value in values if value is not None]
            row.append(Cell(f"{statistics.fmean(known):,.0f}" if known else NONE))
        rows.append(row)
    machine = next(iter(records.values()), {}).get("machine", {})
    device = machine.get("device", {}).get("name", "")
    notes = [
        f"machine: {machine.get('processor')}, {machine.get('cores')} cores, "
        f"{machine.get('memory_gb')} GB, {machine.get('system')}; device {device}",
        "means over all trials, until the end of training; memory of programs: of their main process",
    ]
    return ScoreTable("costs", ["entrant", *_COSTS.values()], 1, rows, notes if records else [])


def _cost(record: dict[str, Any], key: str) -> float | None:
    found: float | None = record[END]["seconds"] if key == "seconds" else record.get(key)
    return found


def as_csv(benchmark: Benchmark, records: Records) -> str:
    """Return CSV with a row for each trial and budget, with all digits."""
    names = list(dict.fromkeys(n for r in records.values() for n in r[END]["test"]))
    head = ["entrant", "scene", "seed", "repeat", "budget", "seconds", *names]
    costs = [key for key in _COSTS if key != "seconds"]
    rows = [
        [
            *_key(trial),
            column,
            state["seconds"],
            *("" if (n := state["test"].get(name)) is None else n for name in names),
            *("" if (cost := record.get(key)) is None else cost for key in costs),
            record["hash"] or "",
            trial.name,
        ]
        for trial, record in records.items()
        for column in columns(benchmark)
        if (state := state_at(record, column)) is not None
    ]
    return csv_text([*head, *costs, "hash", "folder"], rows)


def _key(trial: Trial) -> list[object]:
    return [trial.entrant, trial.scene, trial.seed, trial.repeat]
