"""Trainings and records for tests: a tiny pipeline in the procedural room, and records with given scores."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.campaign import CampaignFolder
from benchmarks.methods_plan import MethodTraining
from benchmarks.records import Record, read, save
from benchmarks.training_process import PIPELINE, measure
from benchmarks.trainings import AnyTraining, Case, Method, Points, Training
from stereogs import build_pipeline

ROOM = Case(
    "room", 3, "", ("scene={use: procedural, width: 48, height: 36, test_views: 2, points: 100}",)
)
MEASURED: dict[str, Any] = {
    "gaussians": 12_345,
    "cpu_seconds": 67.8,
    "seconds": 100.0,
    "peak_memory_mb": 910,
    "device": {"name": "a processor"},
}
SCORES = {"ssim": 0.5, "lpips": 0.25, "avge": 0.125}


def tiny(
    place: Path, name: str = "tiny", initializer: str = "sfm", metrics: str = "[psnr]"
) -> Path:
    """Write a pipeline of four iterations; return its file."""
    file = place / f"{name}.yaml"
    file.write_text(
        f"name: {name}\nscene: procedural\ninitializer: {initializer}\nmetrics: {metrics}\n"
        "training: {iterations: 4, sh_degree: 0}\n"
    )
    return file


def training(file: Path, without: tuple[str, ...] = ()) -> Training:
    """Return a training of a pipeline file in the room."""
    name, pipeline = file.stem, build_pipeline(file, ROOM.overrides)
    method = Method(name, file)
    return Training(
        name, {"method": name, "seed": 0}, ROOM, method, 0, pipeline, "0123456789", without
    )


def folder_in(place: Path) -> CampaignFolder:
    return CampaignFolder(place / "out", place / "records.jsonl")


def train(runs: Sequence[AnyTraining], place: Path) -> tuple[list[Record[AnyTraining]], list[str]]:
    """Train, two at a time; return the records and the errors."""
    folder = folder_in(place)
    folder.path.mkdir()
    outcome = folder.train(runs, 2, None, Console(file=io.StringIO()))
    return read(runs, folder.kept), [*outcome.failures.values()]


def measure_here(runs: Sequence[AnyTraining], place: Path) -> list[Record[AnyTraining]]:
    """Train in this process, which imports nothing anew; return the records."""
    for run in runs:
        folder = folder_in(place).path / run.name
        folder.mkdir(parents=True)
        (folder / PIPELINE).write_text(run.measured_pipeline, "utf-8")
        save(run, measure(folder, None), folder_in(place).kept)
    return read(runs, folder_in(place).kept)


def record(
    method: Method, case: Case, seed: int, psnr: float, points: Points = "own", **measured: Any
) -> Record[MethodTraining]:
    """Return the record of a training that was not made."""
    pipeline: Any = None
    run = MethodTraining("", {}, case, method, seed, pipeline, "", points=points)
    return Record(run, {**MEASURED, "scores": {"psnr": psnr, **SCORES}, **measured})


def rows_of(text: str) -> list[list[str]]:
    """Return the cells of all lines of all tables of a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def row_of(text: str, first: str) -> list[str]:
    """Return the cells of the only line that starts with a cell."""
    (found,) = [row for row in rows_of(text) if row[0] == first]
    return found
