"""The results as tables: for text and HTML as in papers, and CSV with a row per run."""

from __future__ import annotations

import io
import math
from dataclasses import replace

from registry.messages.terminal import PlainConsole
from registry.toolkit.web_page import Cell

from ..planning.plan import Combination, Plan
from ..running.folder import ExperimentFolder
from . import scores
from .score_table import ScoreTable, csv_text
from .scores import CONFIDENCE, COUNTS, ENOUGH_PAIRS, NONE, Column, Results, difference

TICK, CROSS = "✓", "✗"
_WIDTH = 400
"""Characters; wide enough for every row."""


def tables(plan: Plan, results: Results) -> list[ScoreTable]:
    """Return the mean over scenes, each of several scenes, and the differences to the first row."""
    if len(plan.scenes) == 1:
        found = [scene_table(plan, results, plan.scenes[0])]
    else:
        mean = scene_table(plan, results, f"mean over {len(plan.scenes)} scenes", mean=True)
        found = [mean, *(scene_table(plan, results, scene) for scene in plan.scenes)]
    gained = difference_table(plan, results)
    return found if gained is None else [*found, gained]


def scene_table(plan: Plan, results: Results, title: str, *, mean: bool = False) -> ScoreTable:
    """Return the results on the scene `title`, or their mean over all scenes.

    A row with missing runs has no numbers; while runs are missing, the last column counts finished ones.
    """
    scene = None if mean else title
    chosen, columns = _chosen_headings(plan), scores.columns(plan, results)
    head = [*chosen, *(column.heading_with_arrow for column in columns)]
    rows = [_labels(combination) for combination in plan.combinations]
    for column in columns:
        for row, cell in zip(rows, _column(plan, results, column, scene), strict=True):
            row.append(cell)
    progress = [_progress(results, combination, scene) for combination in plan.combinations]
    if any(progress):
        head.append("runs")
        for row, text in zip(rows, progress, strict=True):
            row.append(Cell(text))
    return ScoreTable(title, head, len(chosen), rows)


def difference_table(plan: Plan, results: Results) -> ScoreTable | None:
    """Return each metric's differences to the first row, over pairs of runs with equal scene and seed.

    The differences of the first metric on each of several scenes follow. None if there are too few pairs for
    an interval, or fewer than two rows.
    """
    metrics = [c for c in scores.columns(plan, results) if c.key not in COUNTS]
    pairs = len(plan.scenes) * len(plan.seeds)
    if pairs < ENOUGH_PAIRS or len(plan.combinations) < 2 or not metrics:
        return None
    wanted: list[tuple[Column, str | None]] = [(metric, None) for metric in metrics]
    if len(plan.scenes) > 1:
        wanted += [(metrics[0], scene) for scene in plan.scenes]
    chosen = _chosen_headings(plan)
    head = [*chosen, *(metric.heading if scene is None else scene for metric, scene in wanted)]
    rows = [_labels(combination) for combination in plan.combinations]
    for metric, scene in wanted:
        for row, text in zip(rows, _differences(plan, results, metric, scene), strict=True):
            row.append(Cell(text))
    title = f"differences to {plan.describe(plan.combinations[0])}"
    return ScoreTable(title, head, len(chosen), rows)


def _chosen_headings(plan: Plan) -> list[str]:
    """Return the toggles, and the last part of each varied setting unless it is ambiguous."""
    names = [variation.name for variation in plan.variations]
    ends = [name.split(".")[-1] for name in names]
    short = [end if ends.count(end) == 1 else name for name, end in zip(names, ends, strict=True)]
    return [*plan.toggles, *short]


def _labels(combination: Combination) -> list[Cell]:
    """Return ticks, crosses and values; a dash for a value of a component that is off."""
    toggles = (TICK if on else CROSS for on in combination.on)
    values = (choice.label if choice else NONE for choice in combination.choices)
    return [Cell(text) for text in (*toggles, *values)]


def _column(plan: Plan, results: Results, column: Column, scene: str | None) -> list[Cell]:
    figures = [scores.figure(results, row, column, scene) for row in plan.combinations]
    decimals = scores.decimals(column, figures)
    best = scores.best_of(column, [None if found is None else found.mean for found in figures])
    # The spread of counts and times says little about a method.
    spread = column.key not in COUNTS
    return [
        Cell(NONE if found is None else found.text(decimals, spread=spread), strong)
        for found, strong in zip(figures, best, strict=True)
    ]


def _differences(plan: Plan, results: Results, metric: Column, scene: str | None) -> list[str]:
    rows = plan.combinations
    figures = [scores.figure(results, row, metric, scene) for row in rows]
    decimals = scores.decimals(metric, figures)
    first, *others = (_numbers(results, row, metric, scene) for row in rows)
    found = [difference(numbers, first) for numbers in others]
    return [NONE, *(NONE if one is None else one.text(decimals) for one in found)]


def _numbers(
    results: Results, combination: Combination, metric: Column, scene: str | None
) -> dict[tuple[str, int], float]:
    """Return the finite numbers of a combination by scene and seed; none if a run is missing."""
    own = scores.runs_of(results, combination, scene)
    if not all(own.values()):
        return {}
    numbers = {(run.scene, run.seed): scores.value(found, metric) for run, found in own.items()}
    return {key: n for key, n in numbers.items() if n is not None and math.isfinite(n)}


def _progress(results: Results, combination: Combination, scene: str | None) -> str:
    """Return for example "1/3" while runs are missing, otherwise an empty text."""
    own = scores.runs_of(results, combination, scene).values()
    done = sum(map(bool, own))
    return "" if done == len(own) else f"{done}/{len(own)}"


def as_text(plan: Plan, results: Results) -> str:
    """Return all tables and notes as text."""
    file = io.StringIO()
    console = PlainConsole(file=file, width=_WIDTH, markup=False, highlight=False)
    for table in tables(plan, results):
        console.print(replace(table, title=f"{plan.name}, {table.title}").drawn())
    for line in notes(plan, results):
        console.print(line)
    return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def as_latex(plan: Plan, results: Results) -> str:
    """Return all tables in LaTeX; the notes are comments of the last one."""
    *others, last = (replace(t, title=f"{plan.name}, {t.title}") for t in tables(plan, results))
    noted = replace(last, notes=[*last.notes, *notes(plan, results)])
    return "\n".join(table.latex() for table in (*others, noted))


def notes(plan: Plan, results: Results) -> list[str]:
    """Return notes on the tables: missing metrics, deviations, and combinations without effect."""
    lines = [f"{NONE} {name}: {reason}" for name, reason in scores.unavailable(results).items()]
    if len(plan.seeds) > 1:
        lines.append(f"± standard deviation over {len(plan.seeds)} seeds")
    if difference_table(plan, results) is not None:
        lines.append(
            f"± of differences: {CONFIDENCE:.0%} confidence interval (Student's t) over pairs of equal "
            "scene and seed"
        )
    everywhere = scores.equal_combinations(plan, results)
    lines += [_no_effect(plan, group, "") for group in everywhere]
    for scene in plan.scenes if len(plan.scenes) > 1 else ():
        here = scores.equal_combinations(plan, results, scene)
        lines += [
            _no_effect(plan, group, f" on {scene}") for group in here if group not in everywhere
        ]
    return lines


def _no_effect(plan: Plan, group: list[Combination], where: str) -> str:
    descriptions = " = ".join(plan.describe(combination) for combination in group)
    return f"no effect{where}, bitwise equal Gaussians: {descriptions}"


def as_csv(plan: Plan, results: Results, folder: ExperimentFolder) -> str:
    """Return CSV with a row per run; toggles are 1 and 0, missing values are empty."""
    columns = scores.columns(plan, results)
    chosen = [*plan.toggles, *(variation.name for variation in plan.variations)]
    head = [*chosen, "scene", "seed", *(c.key for c in columns), "hash", "folder"]
    rows = [
        [
            *_chosen(run.combination),
            run.scene,
            run.seed,
            *(_exact(scores.value(found, column)) for column in columns),
            found.get("hash", ""),
            folder.run(run).path.relative_to(folder.path),
        ]
        for run, found in results.items()
    ]
    return csv_text(head, rows)


def means_as_csv(plan: Plan, results: Results) -> str:
    """Return CSV with a row per combination, scene and quantity; toggles are 1 and 0.

    Of several scenes, the mean over all comes first, as scene "". `deviation` is the sample standard
    deviation over seeds, `interval` the half width of the 95 % confidence interval over seeds. `difference`
    is the gain over the first row, over pairs of equal scene and seed. Unknown values are empty.
    """
    chosen = [*plan.toggles, *(variation.name for variation in plan.variations)]
    numbers = ["mean", "deviation", "interval", "difference", "difference_interval"]
    over_all = (None,) if len(plan.scenes) > 1 else ()
    rows = [
        [
            *_chosen(combination),
            scene or "",
            column.key,
            *_mean_numbers(plan, results, combination, column, scene),
        ]
        for scene in (*over_all, *plan.scenes)
        for column in scores.columns(plan, results)
        for combination in plan.combinations
    ]
    return csv_text([*chosen, "scene", "quantity", *numbers], rows)


def _chosen(combination: Combination) -> list[int | str]:
    """Return the toggles as 1 and 0, and the values, empty for a component that is off."""
    return [
        *(int(on) for on in combination.on),
        *(choice.label if choice else "" for choice in combination.choices),
    ]


def _mean_numbers(
    plan: Plan, results: Results, combination: Combination, column: Column, scene: str | None
) -> list[str]:
    mean = scores.figure(results, combination, column, scene)
    own, first = (
        _numbers(results, row, column, scene) for row in (combination, plan.combinations[0])
    )
    gained = difference(own, first) if combination != plan.combinations[0] else None
    found = (
        *((mean.mean, mean.spread, mean.half) if mean else (None, None, None)),
        *((gained.mean, gained.half) if gained else (None, None)),
    )
    return [_exact(number) for number in found]


def _exact(number: float | None) -> str:
    if number is None:
        return ""
    return str(int(number)) if number.is_integer() else repr(number)
