"""Measured trainings in processes of their own, several at a time if requested."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep

from rich.console import Console

from benchmarks import training_records as records
from benchmarks.planned_training import PlannedTraining
from benchmarks.training_process import ANSWER, FAILED, PIPELINE
from registry.system.cores import usable_cores
from registry.system.files import write_text
from registry.system.interrupt import stop_on_interrupt
from registry.toolkit.cache.entries import FOLDER_VARIABLE

THREADS = "POCL_MAX_PTHREAD_COUNT"
Group = Sequence[PlannedTraining]
"""Trainings of one process: one, or several that share their first iterations (`benchmarks.branches`)."""
_SECONDS_BETWEEN_LOOKS = 0.2
_TAIL = 1000
"""Characters of a log that are shown of an unexplained error."""


class Training:
    """A running process.

    Args:
        group: Trainings of the process.
        out: Folder of pipelines, pictures and answers, a subfolder for each; the log is in the first.
        device: Part of the device's name, or None.
        threads: Threads of an OpenCL device that is a processor; None: one for each core.
    """

    def __init__(self, group: Group, out: Path, device: str | None, threads: int | None) -> None:
        self.waiting, self.began = list(group), monotonic()
        self._out = out
        folders = [out / run.name for run in group]
        for run, folder in zip(group, folders, strict=True):
            folder.mkdir(parents=True, exist_ok=True)
            write_text(folder / PIPELINE, run.pipeline.to_yaml())
            (folder / ANSWER).unlink(missing_ok=True)
        command = [sys.executable, "-m", "benchmarks.training_process", *map(str, folders)]
        without = dict.fromkeys(name for run in group for name in run.without)
        command += ["--without", *without]
        # Cached answers of an earlier run would make this one look fast.
        environment = {**os.environ, FOLDER_VARIABLE: ""}
        if threads is not None:
            environment[THREADS] = str(threads)
        self._log = folders[0] / "log.txt"
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(
                command + ([] if device is None else ["--device", device]),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the parent: it stops between runs
            )

    def answered(self) -> list[tuple[PlannedTraining, dict[str, object]]]:
        """Return the measurements since the last call, and stop waiting for them."""
        found = []
        for run in list(self.waiting):
            answer = self._out / run.name / ANSWER
            if answer.is_file():
                found.append((run, json.loads(answer.read_text("utf-8"))))
                self.waiting.remove(run)
        return found

    def failure(self) -> str:
        """Return the error of a process that ended without an answer."""
        log = self._log.read_text("utf-8", errors="replace")
        return failure(log) or f"exit status {self.process.returncode}"


def failure(log: str) -> str:
    """Return the error that ended a training, or else the end of its log."""
    _, explained, error = log.strip().rpartition(FAILED)
    return error if explained else log.strip()[-_TAIL:]


def train(
    waiting: Sequence[Group],
    *,
    jobs: int,
    seconds: float | None,
    device: str | None,
    out: Path,
    kept: Path,
    console: Console,
) -> dict[str, str]:
    """Train in order, `jobs` groups at a time, and save a record of each training when it ends.

    This process alone writes records; the trainings write answers of their own. After `seconds`, or the first
    Ctrl-C, no group is started and the running ones are awaited; a second Ctrl-C kills them.

    Args:
        out: Folder of pipelines, pictures and answers.
        kept: File of records.

    Returns:
        Errors of the failed runs by name; a failure does not stop the other groups.
    """
    queue, working = deque(waiting), list[Training]()
    failures: dict[str, str] = {}
    begin = monotonic()
    threads = None if jobs == 1 else max(1, usable_cores() // jobs)
    with stop_on_interrupt() as stop:
        try:
            while queue or working:
                if stop.requested or (seconds is not None and monotonic() - begin > seconds):
                    queue.clear()
                while queue and len(working) < jobs:
                    working.append(Training(queue.popleft(), out, device, threads))
                for one in list(working):
                    ended = one.process.poll() is not None  # before reading its answers
                    _save(one, kept, console)
                    if ended:
                        working.remove(one)
                        failures |= _failures(one, console)
                sleep(_SECONDS_BETWEEN_LOOKS)
        finally:
            for one in working:
                one.process.kill()
                one.process.wait()
    return failures


def _save(working: Training, kept: Path, console: Console) -> None:
    for run, measured in working.answered():
        records.save(run, measured, kept)
        console.print(f"{run.name}: {monotonic() - working.began:.0f} s")


def _failures(ended: Training, console: Console) -> dict[str, str]:
    """The error of the process, by the name of each run without an answer."""
    failures = {run.name: ended.failure() for run in ended.waiting}
    for name, message in failures.items():
        console.print(f"{name} failed: {message}")
    return failures
