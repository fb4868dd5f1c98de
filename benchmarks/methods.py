"""Every method under one protocol: `python -m benchmarks.methods`, which `make methods` runs.

Each training is a process of its own and leaves a record in `benchmarks/records/methods`; what has one
of the same pipeline is not trained again, so that the same command goes on where it was stopped. A change
of the code is not seen; remove records to measure anew. Pictures of the test views lie in
`benchmarks/out/methods`. With `--write-docs` the table in docs/methods.md is rewritten from the records
that are there, also while some are missing.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep

from rich.console import Console

from benchmarks import methods_records as records
from benchmarks.marked_page import rewrite
from benchmarks.methods_page import BEGIN, END, page_text
from benchmarks.methods_plan import METHODS, SCENES, SEEDS, MethodRun, planned_runs
from benchmarks.methods_run import FAILED
from benchmarks.results_plan import check_data
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.cache import FOLDER_VARIABLE
from registry.plugins.discovery import Plugins
from registry.runs.interrupt import stop_on_interrupt
from registry.system.files import write_text

OUT = Path(__file__).parent / "out" / "methods"
PAGE = Path(__file__).parent.parent / "docs" / "methods.md"
THREADS = "POCL_MAX_PTHREAD_COUNT"
INTERRUPTED = 130
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
        self, run: MethodRun, folder: Path, device: str | None, threads: int | None
    ) -> None:
        self.run, self.began = run, monotonic()
        folder.mkdir(parents=True, exist_ok=True)
        pipeline = folder / "pipeline.yaml"
        self._log, self._answer = folder / "log.txt", folder / "answer.json"
        self._answer.unlink(missing_ok=True)
        write_text(pipeline, run.pipeline.to_yaml())
        command = [sys.executable, "-m", "benchmarks.methods_run"]
        command += [str(pipeline), str(folder / "renders"), str(self._answer)]
        # Answers from an earlier run would make this one look fast.
        environment = {**os.environ, FOLDER_VARIABLE: ""}
        if threads is not None:
            environment[THREADS] = str(threads)
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(
                command + ([] if device is None else [device]),
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
    waiting: Sequence[MethodRun],
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time (%(default)s)")
    parser.add_argument("--seconds", type=float, help="begin no other training after so long")
    parser.add_argument(
        "--write-docs", action="store_true", help=f"rewrite the table in {PAGE.name}"
    )
    arguments = parser.parse_args()
    console = Console(markup=False, highlight=False, soft_wrap=True)
    try:
        check_data(SCENES)
        runs = planned_runs(METHODS, SCENES, SEEDS, Plugins())
        done = {record.run.name for record in records.read(runs, records.RECORDS)}
        waiting = [run for run in runs if run.name not in done]
        console.print(f"{len(runs)} runs, {len(waiting)} to train")
        failures = train(
            waiting,
            jobs=arguments.jobs,
            seconds=arguments.seconds,
            device=arguments.device,
            out=OUT,
            kept=records.RECORDS,
            console=console,
        )
        found = records.read(runs, records.RECORDS)
        text = page_text(found)
        console.print(text)
        if arguments.write_docs:
            rewrite(PAGE, BEGIN, END, text)
        if failures:
            name, said = next(iter(failures.items()))
            raise RunError(f"{len(failures)} runs failed; the first one said:\n{said}", where=name)
        if len(found) < len(runs):
            console.print(f"{len(runs) - len(found)} are missing; the same command goes on")
            return INTERRUPTED
    except ExplainedError as error:
        sys.exit(f"methods: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
