"""Trains what a plan still lacks, several at a time, and can be stopped at any moment."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from rich.console import Console

from registry.pipeline.parts import Part
from registry.runners import Runner, RunningTask, TrainingTask
from registry.runs.interrupt import stop_on_interrupt

from ..planning.plan import PlannedRun
from .folder import AblationFolder
from .progress import AblationProgress

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


class _Working(NamedTuple):
    planned: PlannedRun
    task: RunningTask


def train_all(
    waiting: Sequence[PlannedRun],
    folder: AblationFolder,
    runner: Part,
    *,
    device: str | None,
    console: Console,
) -> Outcome:
    """Train the runs, in order, as many at a time as the runner has places.

    A failure does not keep the others from being trained. The first Ctrl-C asks those at work to stop
    and waits for them; a second one ends them at once.

    Args:
        waiting: what is not finished.
        runner: who trains them.
        device: as for `--device`.
    """
    crew = _Crew(runner, folder, device)
    queue = deque(waiting)
    outcome = Outcome()
    with stop_on_interrupt() as stop, AblationProgress(len(waiting), console) as progress:
        try:
            while queue or crew.working:
                if stop.requested and not outcome.stopped:
                    outcome.stopped = True
                    queue.clear()
                    crew.stop()
                while queue and crew.has_place:
                    crew.start(queue.popleft())
                for planned, failure in crew.ended():
                    if failure and not outcome.stopped:
                        outcome.failures[planned] = failure
                    name = folder.run(planned).path.name
                    progress.ended(name, "stopped" if failure and outcome.stopped else failure)
                progress.show(crew.progress)
                time.sleep(_SECONDS_BETWEEN_LOOKS)
        finally:
            crew.close()
    return outcome


class _Crew:
    """The tasks of a runner that are at work; each call into the runner is watched."""

    def __init__(self, runner: Part, folder: AblationFolder, device: str | None) -> None:
        self._part, self._folder, self._device = runner, folder, device
        self._runner: Runner = runner.component
        self.working: list[_Working] = []

    @property
    def has_place(self) -> bool:
        """Whether the runner takes one more."""
        with self._part.at_work():
            places = self._runner.places
        return places is None or len(self.working) < places

    @property
    def progress(self) -> list[float]:
        """The share of each that is done."""
        with self._part.at_work():
            return [working.task.progress() for working in self.working]

    def start(self, planned: PlannedRun) -> None:
        """Begin a run."""
        run = self._folder.run(planned).path
        task = TrainingTask(
            planned.pipeline.to_yaml(),
            run,
            run.with_name(f"{run.name}.log"),
            self._device,
        )
        with self._part.at_work():
            self.working.append(_Working(planned, self._runner.start(task)))

    def ended(self) -> list[tuple[PlannedRun, str]]:
        """Those that have ended since the last call, and what went wrong; empty if nothing did."""
        found = []
        for working in list(self.working):
            with self._part.at_work():
                if not working.task.ended:
                    continue
                failure = working.task.failure()
            self.working.remove(working)
            if not failure and not self._folder.results(working.planned):
                failure = (
                    "it left no results of this pipeline; has a plugin changed since the "
                    "ablation began?"
                )
            found.append((working.planned, failure))
        return found

    def stop(self) -> None:
        """Ask all to end soon."""
        with self._part.at_work():
            for working in self.working:
                working.task.stop()

    def close(self) -> None:
        """End what has not ended, and let the runner go."""
        with self._part.at_work():
            for working in self.working:
                working.task.kill()
            self._runner.close()
