"""The folder of a benchmark: a folder per trial in `runs`, whose record says what was asked and found."""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from registry import RunError
from registry.runners import RunningTask, TrainingTask
from registry.system.files import write_json

from ..running.folder import RUNS
from ..running.local_processes import LocalProcesses, TrainingProcess
from .description import Benchmark, Trial
from .trial import RECORD, TASK

_MODULE = "stereogs.experiments.benchmarking.trial"
Records = Mapping[Trial, dict[str, Any]]
"""The record of each finished trial."""


class TrialProcesses(LocalProcesses):
    """Runs one trial at a time, always from its start: seconds need the whole machine."""

    @property
    def places(self) -> int:
        """Trainings at the same time: one."""
        return 1

    def start(self, task: TrainingTask) -> RunningTask:
        """Start the process of a trial in an empty folder with its task."""
        shutil.rmtree(task.folder, ignore_errors=True)
        task.folder.mkdir(parents=True)
        write_json(task.folder / TASK, json.loads(task.pipeline))
        words = [_MODULE, str(task.folder.absolute()), "--started", repr(time.time())]
        return TrainingProcess(task, words, self.lock)


class TrialFolder:
    """The trials of a benchmark below a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def task(self, planned: Trial, device: str | None) -> TrainingTask:
        """Return the task that trains a trial: its JSON in place of a pipeline."""
        folder = self.path / RUNS / planned.name
        log = folder.with_name(f"{folder.name}.log")
        return TrainingTask(json.dumps(planned.asked), folder, log, device)

    def keep(self, planned: Trial) -> bool:
        """Return whether the trial left its record; its copies of the Gaussians are not needed any more."""
        return bool(self.record(planned))

    def record(self, planned: Trial) -> dict[str, Any]:
        """Return the record of a finished trial, empty if there is none.

        Raises:
            RunError: the record is damaged, or of something else than was asked for.
        """
        file = self.path / RUNS / planned.name / RECORD
        if not file.is_file():
            return {}
        fix = f"remove {file.parent}; the same command then repeats the trial"
        try:
            found = dict(json.loads(file.read_text("utf-8")))
            asked, end = found["asked"], found["end"]
            numbers = [end["seconds"], *(n for n in end["test"].values() if n is not None)]
            if not all(math.isfinite(number) for number in numbers):
                raise ValueError("a number is not finite")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RunError(f"the record is damaged: {error}", where=str(file), fix=fix) from error
        if asked != json.loads(json.dumps(planned.asked)):
            what = "the record is of another configuration than was asked for"
            raise RunError(what, where=str(file), fix=fix)
        protocol, wanted = found.get("protocol"), planned.pipeline.protocol
        if wanted is None or protocol != json.loads(json.dumps(wanted.record())):
            what = "the record does not state this protocol, or an older version of it"
            raise RunError(what, where=str(file), fix=fix)
        return found


def read_records(benchmark: Benchmark, folder: TrialFolder) -> Records:
    """Return the records of all finished trials.

    Raises:
        RunError: records are of two machines, two versions of a program, or different test photographs or
            cameras of a scene.
    """
    found = {trial: record for trial in benchmark.trials if (record := folder.record(trial))}
    firsts: dict[tuple[str, str], tuple[Trial, Any]] = {}
    for trial, record in found.items():
        for part, group in (
            ("machine", ""),
            ("software", trial.entrant if trial.program else ""),
            ("inputs", trial.scene),
        ):
            first, value = firsts.setdefault((part, group), (trial, record[part]))
            if value != record[part]:
                raise RunError(
                    f"the {part} of two records differ: {_difference(value, record[part])}",
                    where=f"{folder.path / RUNS / first.name} and {trial.name}",
                    fix="records of two machines, versions or data are in no common table: use another --out",
                )
    return found


def _difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    key = next(k for k in {**one, **other} if one.get(k) != other.get(k))
    return f"{key} is {one.get(key)} and {other.get(key)}"
