"""Trainings that are measured, each in a process of its own, several at a time where one asks for it."""

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
from benchmarks.training_process import FAILED
from registry.cache import FOLDER_VARIABLE
from registry.runs.interrupt import stop_on_interrupt
from registry.system.files import write_text

THREADS = "POCL_MAX_PTHREAD_COUNT"
RENDERS = "renders"
_SECONDS_BETWEEN_LOOKS = 0.2
_TAIL = 1000
"""Characters of a log that are shown of an error that nobody explained."""


class Training:
    """A training at work.

    Args:
        run: what is trained.
        folder: where its pipeline, pictures, log and answer lie.
        device: part of the device's name, or None.
        threads: of an OpenCL device that is a processor; None: as many as there are cores.
    """

    def __init__(
        self, run: PlannedTraining, folder: Path, device: str | None, threads: int | None
    ) -> None:
        self.run, self.began = run, monotonic()
        folder.mkdir(parents=True, exist_ok=True)
        pipeline = folder / "pipeline.yaml"
        self._log, self._answer = folder / "log.txt", folder / "answer.json"
        self._answer.unlink(missing_ok=True)
        write_text(pipeline, run.pipeline.to_yaml())
        command = [sys.executable, "-m", "benchmarks.training_process"]
        command += [str(pipeline), str(folder / RENDERS), str(self._answer)]
        command += ["--without", *run.without]
        # Answers from an earlier run would make this one look fast.
        environment = {**os.environ, FOLDER_VARIABLE: ""}
        if threads is not None:
            environment[THREADS] = str(threads)
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(
                command + ([] if device is None else ["--device", device]),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the parent: it stops between runs
            )

    def outcome(self) -> dict[str, object] | str:
        """What an ended training measured, or what a failed one said."""
        if self._answer.is_file():
            measured: dict[str, object] = json.loads(self._answer.read_text("utf-8"))
            return measured
        log = self._log.read_text("utf-8", errors="replace")
        return failure(log) or f"exit status {self.process.returncode}"


def failure(log: str) -> str:
    """The error that ended a training, or else the end of what it printed."""
    _, explained, error = log.strip().rpartition(FAILED)
    return error if explained else log.strip()[-_TAIL:]


def train(
    waiting: Sequence[PlannedTraining],
    *,
    jobs: int,
    seconds: float | None,
    device: str | None,
    out: Path,
    kept: Path,
    console: Console,
) -> dict[str, str]:
    """Train in order, `jobs` at a time, and save a record of each as it ends.

    After `seconds`, or the first Ctrl-C, no other is begun and those at work are waited for; a second
    Ctrl-C ends them.

    Returns:
        What each run that failed said, by name; a failure keeps no other from being trained.
    """
    queue, working = deque(waiting), list[Training]()
    failures: dict[str, str] = {}
    begin = monotonic()
    threads = None if jobs == 1 else max(1, (os.cpu_count() or 1) // jobs)
    with stop_on_interrupt() as stop:
        try:
            while queue or working:
                if stop.requested or (seconds is not None and monotonic() - begin > seconds):
                    queue.clear()
                while queue and len(working) < jobs:
                    run = queue.popleft()
                    working.append(Training(run, out / run.name, device, threads))
                for ended in [one for one in working if one.process.poll() is not None]:
                    working.remove(ended)
                    failures |= _finish(ended, kept, console)
                sleep(_SECONDS_BETWEEN_LOOKS)
        finally:
            for one in working:
                one.process.kill()
                one.process.wait()
    return failures


def _finish(ended: Training, kept: Path, console: Console) -> dict[str, str]:
    """Save the record; what a training that failed said, by name."""
    name, outcome = ended.run.name, ended.outcome()
    if isinstance(outcome, str):
        console.print(f"{name} failed: {outcome}")
        return {name: outcome}
    records.save(ended.run, outcome, kept)
    console.print(f"{name}: {monotonic() - ended.began:.0f} s")
    return {}
