"""Trainings of `make parts`: the short form of StereoGS and its variants by ablation files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from pydantic import BaseModel

from benchmarks.methods_plan import STEREOGS, as_authors_set_it
from benchmarks.results_plan import cases
from benchmarks.trainings import DATA, MODELS, PIPELINES, SEEDS, Case, Method, Training, digest_of
from registry.discovery import Plugins
from registry.pipeline.edits import apply_override
from registry.pipeline.pipeline import Pipeline
from stereogs.experiments.planning.description import read_description
from stereogs.experiments.planning.making import make_plan
from stereogs.experiments.planning.plan import Combination, Plan

METRICS = "metrics=[psnr, ssim, lpips, {use: lpips, name: lpips_alex, network: alex}]"
NOTHING = "nothing"
"""The row with every toggle off."""


@dataclass(frozen=True)
class Table:
    """A table of ablations.

    Args:
        title: Heading.
        files: Names of ablation files with the rows to take from each; empty rows take all.
        cases: Columns.
        baseline: Row that the others are compared with.
        paper: Table of the StereoGS paper with the same rows, or None.
        method: Method whose pipeline is changed.
        changes: Overrides applied first, as for `--set`.
    """

    title: str
    files: tuple[tuple[str, tuple[str, ...]], ...]
    cases: tuple[Case, ...]
    baseline: str
    paper: str | None = None
    method: Method = STEREOGS
    changes: tuple[str, ...] = ()

    @property
    def toggles(self) -> bool:
        """If True, rows are parts that are on or off."""
        return self.paper == "components"


_LLFF = cases("llff_fern-3", "llff_flower-3")
EIGHT = Table("The eight rows", (("parts", ()),), _LLFF, NOTHING, "components")
OBJECTS = Table(
    "Around objects",
    (
        (
            "parts",
            (NOTHING, "initializer", "initializer, opacity", "initializer, stereo_depth, opacity"),
        ),
    ),
    cases("dtu_scan24-3", "dtu_scan65-3"),
    NOTHING,
    "components",
)
WEIGHT_FREE = Method("StereoGS without networks", PIPELINES / "stereogs_weightfree.yaml")
SHORTER = ("training.iterations=600",)
CLASSICAL = Table(
    "Without networks", (("parts", ()),), _LLFF, NOTHING, "components", WEIGHT_FREE, SHORTER
)
TERM_TABLE = Table(
    "The stereo term",
    (("small_stereo_models", ("none", "sgm")), ("stereo_term", ())),
    _LLFF,
    "none",
)
TABLES = (
    EIGHT,
    TERM_TABLE,
    Table(
        "The decay functions",
        (("decay_function", ()), ("decay_base", ("0.98",))),
        _LLFF,
        "exp_beta",
        "decay_strategy",
    ),
    Table("The first points", (("small_multi_view_models", ()),), _LLFF, "itermvs"),
    OBJECTS,
    CLASSICAL,
    Table(
        "The decay functions without networks",
        (("decay_function", ()),),
        _LLFF,
        "exp_beta",
        "decay_strategy",
        WEIGHT_FREE,
        SHORTER,
    ),
)


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Args:
        table: Title of the table.
        place: Index of the file in the table, and of the row in the file.
        label: Parts that are on, or the value that is varied.
    """

    table: str
    place: tuple[int, int]
    label: str


@dataclass(frozen=True, eq=False)
class PartsTraining(Training):
    """A training of some rows.

    Args:
        rows: Lines that show it.
    """

    rows: tuple[Row, ...] = ()


def planned_runs(
    tables: Sequence[Table], plugins: Plugins, seeds: Sequence[int] = SEEDS
) -> list[PartsTraining]:
    """Return all runs of some tables, sorted by seed.

    A pipeline of several rows is a single run.

    Raises:
        PipelineError: a file cannot be read or contradicts the protocol.
    """
    runs: dict[tuple[str, int, str], PartsTraining] = {}
    for table in tables:
        found = [
            run
            for case, number in product(table.cases, range(len(table.files)))
            for run in _runs(table, number, case, len(seeds), plugins)
        ]
        for run in found:
            known = runs.setdefault((run.case.data, run.seed, run.digest), run)
            if known is not run:
                runs[run.case.data, run.seed, run.digest] = replace(
                    known, rows=(*known.rows, *run.rows)
                )
    return sorted(runs.values(), key=lambda run: run.seed)


def _runs(
    table: Table, number: int, case: Case, seeds: int, plugins: Plugins
) -> Iterator[PartsTraining]:
    """The runs of one of the table's files."""
    file, only = table.files[number]
    path = PIPELINES / "ablations" / f"{file}.yaml"
    description = replace(read_description(path, table.method.file), scenes=(), seeds=seeds)
    tree = description.pipeline
    as_authors_set_it(tree, table.method, case)
    for override in (*case.overrides, *table.changes, METRICS, "training.seed=0"):
        apply_override(tree, override)
    plan = make_plan(description, plugins)
    for run in plan.runs:
        label = label_of(plan, run.combination)
        if only and label not in only:
            continue
        row = Row(table.title, (number, plan.combinations.index(run.combination)), label)
        digest = _digest(run.pipeline)
        yield PartsTraining(
            f"{case.data}_{run.seed}_{digest}",
            {"row": f"{table.title}: {label}", "data": case.data, "seed": run.seed},
            case,
            table.method,
            run.seed,
            run.pipeline,
            digest,
            rows=(row,),
        )


def label_of(plan: Plan, combination: Combination) -> str:
    """Return the names of the parts that are on, or the value that is varied."""
    chosen = [choice.label for choice in combination.choices if choice is not None]
    on = [name for name, is_on in zip(plan.toggles, combination.on, strict=True) if is_on]
    return ", ".join([*on, *chosen]) or NOTHING


def _digest(pipeline: Pipeline) -> str:
    """Ten hexadecimal digits of a pipeline's settings, independent of the location of data and models."""
    content: list[Any] = [_set(pipeline.training)]
    content += [pipeline.protocol.written if pipeline.protocol else None]
    content += [[item.qualified_name, _set(item.host), _set(item.settings)] for item in pipeline]
    text = json.dumps(content, sort_keys=True)
    for variable in (DATA, MODELS):
        if place := os.environ.get(variable):
            text = text.replace(json.dumps(place)[1:-1], f"${{{variable}}}")
    return digest_of(text)


def _set(settings: BaseModel) -> Any:
    return settings.model_dump(mode="json", exclude_defaults=True)
