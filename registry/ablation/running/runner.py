"""Trains what a plan still lacks, several at a time, and can be stopped at any moment."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from rich.console import Console

from ...runs.interrupt import stop_on_interrupt
from ..planning.plan import PlannedRun
from .folder import AblationFolder
from .progress import AblationProgress
from .training_process import TrainingProcess

_SECONDS_BETWEEN_LOOKS = 0.2


@dataclass
class Outcome:
    """How it went.

    Args:
        stopped: the user pressed Ctrl-C.
        failures: what each run that failed said.
    """

    stopped: bool = False
    failures: dict[PlannedRun, str] = field(default_factory=dict)


def train_all(
    waiting: Sequence[PlannedRun],
    folder: AblationFolder,
    *,
    jobs: int,
    device: str | None,
    lock: int | None,
    console: Console,
) -> Outcome:
    """Train the runs, in order, `jobs` at a time.

    A failure does not keep the others from being trained. The first Ctrl-C asks those at work to stop
    with a checkpoint and waits for them; a second one ends them at once.

    Args:
        waiting: what is not finished.
        device: as for `--device`.
        lock: see `AblationFolder.locked`.
    """
    queue = deque(waiting)
    working: list[TrainingProcess] = []
    outcome = Outcome()
    with stop_on_interrupt() as stop, AblationProgress(len(waiting), console) as progress:
        try:
            while queue or working:
                if stop.requested and not outcome.stopped:
                    outcome.stopped = True
                    queue.clear()
                    for process in working:
                        process.stop()
                while queue and len(working) < jobs:
                    planned = queue.popleft()
                    run = folder.run(planned)
                    working.append(TrainingProcess(planned, run, device=device, lock=lock))
                for process in [process for process in working if process.ended]:
                    working.remove(process)
                    failure = _failure(process, folder)
                    if failure and not outcome.stopped:
                        outcome.failures[process.planned] = failure
                    progress.ended(process, "stopped" if failure and outcome.stopped else failure)
                progress.show(working)
                time.sleep(_SECONDS_BETWEEN_LOOKS)
        finally:
            for process in working:
                process.kill()
    return outcome


def _failure(process: TrainingProcess, folder: AblationFolder) -> str:
    """What went wrong; empty if there are results of what was planned."""
    failure = process.failure()
    if not failure and not folder.results(process.planned):
        return "it left no results of this pipeline; has a plugin changed since the ablation began?"
    return failure
