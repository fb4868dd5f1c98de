"""The numbers as tables: text like the tables of papers, and CSV with a row a run."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.table import Table

from registry.messages import PlainConsole

from ..planning.plan import Combination, Plan
from ..running.folder import AblationFolder
from . import scores
from .differences import Differences, differences
from .scores import COUNTS, NONE, Column, Figure, Results

TICK, CROSS = "✓", "✗"
_WIDTH = 400
"""Characters; wide enough that no cell is ever cut."""


@dataclass(frozen=True)
class Row:
    """A row of a table, every cell as text.

    Args:
        toggles: a tick or a cross for each toggle.
        values: the value of each variation; a dash where what it varies is off.
        numbers: of each column; a dash where a run is missing.
        best: for each column whether no other row is better.
        progress: "1/3" of the table's runs while some are missing, else empty.
    """

    toggles: tuple[str, ...]
    values: tuple[str, ...]
    numbers: tuple[str, ...]
    best: tuple[bool, ...]
    progress: str


def rows(plan: Plan, results: Results, scene: str | None = None) -> list[Row]:
    """The table's rows: the mean over all scenes, or one scene's numbers."""
    texts, best = [], []
    for column in scores.columns(plan, results):
        figures = [scores.figure(results, row, column, scene) for row in plan.combinations]
        places = scores.decimals(column, figures)
        texts.append([NONE if found is None else _text(found, column, places) for found in figures])
        best.append(best_of(column, [None if found is None else found.mean for found in figures]))
    return [
        Row(
            *labels(combination),
            tuple(text[index] for text in texts),
            tuple(mark[index] for mark in best),
            _progress(results, combination, scene),
        )
        for index, combination in enumerate(plan.combinations)
    ]


def labels(combination: Combination) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Ticks and crosses, and values, as tables show them."""
    toggles = tuple(TICK if on else CROSS for on in combination.on)
    return toggles, tuple(choice.label if choice else NONE for choice in combination.choices)


def headings(plan: Plan, results: Results) -> tuple[list[str], list[str]]:
    """Of what was chosen, and of what was measured, with an arrow towards better."""
    arrows = {True: " ↑", False: " ↓", None: ""}
    measured = scores.columns(plan, results)
    return (
        [*plan.toggles, *_short([variation.name for variation in plan.variations])],
        [f"{column.heading}{arrows[column.higher_is_better]}" for column in measured],
    )


def titles(plan: Plan) -> list[tuple[str, str | None]]:
    """The tables there are, by title and scene: the mean over the scenes, then each of several."""
    if len(plan.scenes) == 1:
        return [(plan.scenes[0], None)]
    return [(f"mean over {len(plan.scenes)} scenes", None), *((s, s) for s in plan.scenes)]


def as_text(plan: Plan, results: Results) -> str:
    """All tables, and below them what must be known beside the numbers."""
    file = io.StringIO()
    console = PlainConsole(file=file, width=_WIDTH, markup=False, highlight=False)
    for title, scene in titles(plan):
        console.print(_table(plan, results, f"{plan.name}, {title}", scene))
    gained = differences(plan, results)
    if gained is not None:
        console.print(_differences(plan, results, gained))
    for line in notes(plan, results):
        console.print(line)
    return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def notes(plan: Plan, results: Results) -> list[str]:
    """What a reader must know beside the numbers."""
    lines = [f"{NONE} {name}: {reason}" for name, reason in scores.unavailable(results).items()]
    if len(plan.seeds) > 1:
        lines.append(f"± standard deviation over {len(plan.seeds)} seeds")
    gained = differences(plan, results)
    if gained is not None:
        lines.append(gained.note)
    everywhere = scores.without_effect(plan, results)
    lines += [_same(plan, group, "") for group in everywhere]
    for scene in plan.scenes if len(plan.scenes) > 1 else ():
        here = scores.without_effect(plan, results, scene)
        lines += [_same(plan, group, f" in {scene}") for group in here if group not in everywhere]
    return lines


def _same(plan: Plan, group: list[Combination], where: str) -> str:
    descriptions = " = ".join(plan.describe(combination) for combination in group)
    return f"no effect{where}, the same Gaussians to the bit: {descriptions}"


def as_csv(plan: Plan, results: Results, folder: AblationFolder) -> str:
    """A row a run, in the plan's order; toggles are 1 and 0, what is not there is empty."""
    measured = scores.columns(plan, results)
    chosen = [*plan.toggles, *(variation.name for variation in plan.variations)]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([*chosen, "scene", "seed", *(c.key for c in measured), "hash", "folder"])
    for run, found in results.items():
        choices = (choice.label if choice else "" for choice in run.combination.choices)
        numbers = (scores.value(found, column) for column in measured)
        writer.writerow(
            [
                *(int(on) for on in run.combination.on),
                *choices,
                run.scene,
                run.seed,
                *(_exact(number) for number in numbers),
                found.get("hash", ""),
                folder.run(run).path.relative_to(folder.path),
            ]
        )
    return file.getvalue()


def _exact(number: float | None) -> str:
    if number is None:
        return ""
    return str(int(number)) if number.is_integer() else repr(number)


def _table(plan: Plan, results: Results, title: str, scene: str | None) -> Table:
    table = _empty(title, *headings(plan, results))
    found = rows(plan, results, scene)
    incomplete = any(row.progress for row in found)
    if incomplete:
        table.add_column("runs", justify="right")
    for row in found:
        table.add_row(*row.toggles, *row.values, *row.numbers, *([row.progress] * incomplete))
    return table


def _differences(plan: Plan, results: Results, gained: Differences) -> Table:
    chosen, _ = headings(plan, results)
    table = _empty(f"{plan.name}, {gained.title}", chosen, gained.headings)
    for combination, texts in zip(plan.combinations, gained.rows, strict=True):
        toggles, choices = labels(combination)
        table.add_row(*toggles, *choices, *texts)
    return table


def _empty(title: str, chosen: Sequence[str], measured: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for heading in chosen:
        table.add_column(heading, justify="center")
    for heading in measured:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _short(names: list[str]) -> list[str]:
    """The last part of each dotted name, or the whole name where two end alike."""
    ends = [name.split(".")[-1] for name in names]
    return [end if ends.count(end) == 1 else name for name, end in zip(names, ends, strict=True)]


def _text(found: Figure, column: Column, decimals: int) -> str:
    """The spread of time and memory says little about a method, and is left out."""
    return found.text(decimals, spread=column.key not in COUNTS)


def best_of(column: Column, means: list[float | None]) -> list[bool]:
    """Which of a column's values are the best; none where there is only one, or neither end is better."""
    known = [mean for mean in means if mean is not None]
    if column.higher_is_better is None or len(known) < 2:
        return [False] * len(means)
    best = max(known) if column.higher_is_better else min(known)
    return [mean == best for mean in means]


def _progress(results: Results, combination: Combination, scene: str | None) -> str:
    done, total = scores.finished(results, combination, scene)
    return "" if done == total else f"{done}/{total}"
