"""Choose a runner, and train many runs with it: for `ablate`, `bench` and the campaigns of `benchmarks/`."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Generic, NamedTuple, Protocol, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from core_rasterizer import Device
from registry.contract.hook_points import HOOK_POINTS, HookPoint
from registry.discovery import OWN_PACKAGE, Offer, Plugins
from registry.errors import PipelineError
from registry.pipeline.edits import expand
from registry.pipeline.parts import Part, build_part
from registry.pipeline.pipeline import component_item
from registry.pipeline.training_settings import iterations_of_a_run
from registry.pipeline.yaml_source import Node, Place
from registry.runners import Runner, RunningTask, TrainingTask
from registry.runs.folder import METRICS, RunFolder
from registry.system.interrupt import stop_on_interrupt

from .local_processes import LocalProcesses
from .queue import Planned, Queue, State

Kept = TypeVar("Kept", contravariant=True)
LOCAL = "local"
"""Name of the default runner."""
RUNNER = next(point for point in HOOK_POINTS if point.section == "runner")
_POLL_SECONDS = 0.2
_TAIL_BYTES = 8192
STOP_SECONDS = 8.0
"""Time after Ctrl-C in which a training may finish its iteration and write a checkpoint."""


def choose_runner(
    written: Node | None,
    jobs: int | None,
    plugins: Plugins,
    device: Device,
    local: type[LocalProcesses] = LocalProcesses,
) -> Part:
    """Build a runner.

    Args:
        written: a component as in a pipeline; None for `local`.
        jobs: replaces the setting `jobs` of `local`.
        local: the class of the runner `local`.

    Raises:
        PipelineError: invalid settings, or `jobs` with another runner than `local`.
        PluginError: no plugin offers the runner, or it cannot be loaded or built.
    """

    def find(point: HookPoint, name: str, preferred: str | None) -> Offer:
        if name != LOCAL:
            return plugins.find(point, name, preferred)
        return Offer(point, LOCAL, local, "registry", OWN_PACKAGE, version(OWN_PACKAGE))

    if jobs is not None:
        place = Place(f"--jobs {jobs}")
        if written is not None and not _is_local(written):
            raise PipelineError(
                "the named runner decides itself how many trainings run at the same time",
                where=str(place),
                fix="remove --jobs, or use the runner `local`",
            )
        written = Node({"use": Node(LOCAL, place), "jobs": Node(jobs, place)}, place)
    node = written or Node(LOCAL, Place("the runner"))
    item = component_item(RUNNER, node, find, iterations=1)
    if item is None:
        raise PipelineError("the runner is disabled", where=str(node.place), fix="remove `enabled`")
    return build_part(item, 0, device)


def _is_local(node: Node) -> bool:
    return "use" in (written := expand(node)) and written["use"].content == LOCAL


class Keeper(Protocol[Kept]):
    """Where the results of trainings are kept. A training whose results are kept is not repeated."""

    def task(self, planned: Kept, device: str | None) -> TrainingTask:
        """Return the task that trains it."""
        ...

    def keep(self, planned: Kept) -> bool:
        """Keep the results that its task left; return False if it left none of this pipeline."""
        ...


@dataclass
class Outcome(Generic[Planned]):
    """The outcome of `train_all`: whether Ctrl-C stopped it, and the error of each failed training."""

    stopped: bool = False
    failures: dict[Planned, str] = field(default_factory=dict)

    def add(self, planned: Planned, state: State | None, failure: str) -> None:
        """Note the end of a training."""
        if state not in (None, "stopped"):
            self.failures[planned] = failure


def train_all(
    waiting: Sequence[Planned] | Queue[Planned],
    keeper: Keeper[Planned],
    runner: Part,
    *,
    device: str | None,
    console: Console,
) -> Outcome[Planned]:
    """Train in order, as many at a time as the runner allows.

    If a training fails, the others are still trained. The first Ctrl-C stops the active ones, and kills those
    that go on for `STOP_SECONDS`; a second one kills them at once.

    Args:
        waiting: the unfinished trainings, or a queue that is shared with other processes.
        keeper: the tasks of the trainings, and the place of their results.
        runner: from `choose_runner`.
        device: as for `--device`.
    """
    active = _ActiveTasks(runner, keeper, device)
    queue = waiting if isinstance(waiting, Queue) else Queue(waiting)
    outcome, progress, deadline = Outcome[Planned](), PoolProgress(len(queue), console), math.inf
    with stop_on_interrupt() as stop, progress.bar:
        try:
            while queue or active.tasks:
                if stop.requested and not outcome.stopped:
                    outcome.stopped, deadline = True, time.monotonic() + STOP_SECONDS
                    queue.clear()
                    active.stop()
                if time.monotonic() > deadline:
                    break  # `close` kills them; what they saved before stays
                active.drop(queue.lost())
                while queue and active.has_place and (planned := queue.take()) is not None:
                    active.start(planned)
                for end in active.take_ended():
                    state = end.state(stopped=outcome.stopped)
                    if queue.ended(end.planned, state, end.failure):
                        outcome.add(end.planned, state, end.failure)
                        progress.ended(end.name, "stopped" if state == "stopped" else end.failure)
                for planned, failure in queue.take_settled():
                    outcome.add(planned, "failed" if failure else None, failure)
                    progress.ended(keeper.task(planned, device).folder.name, failure)
                progress.show(active.progress)
                time.sleep(_POLL_SECONDS)
        finally:
            active.close()
    return outcome


@dataclass
class _ActiveTask(Generic[Planned]):
    planned: Planned
    folder: Path
    task: RunningTask

    def progress(self) -> float:
        """Return the finished share, of the runner or by the log of iterations in the run folder."""
        if share := self.task.progress():
            return share
        try:
            with (self.folder / METRICS).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL_BYTES))
                last = file.read().splitlines()[-1]
            return int(json.loads(last)["iteration"]) / self._iterations
        except (OSError, ValueError, KeyError, IndexError, TypeError, ZeroDivisionError):
            return 0.0  # no file yet, or an incomplete line

    @cached_property
    def _iterations(self) -> int:
        """The run's length, which may depend on its scene."""
        return iterations_of_a_run(RunFolder(self.folder).pipeline.read_text("utf-8"))


class _End(NamedTuple, Generic[Planned]):
    """The end of a task, with the training's error, empty after success."""

    planned: Planned
    name: str
    failure: str
    data_missing: bool

    def state(self, *, stopped: bool) -> State | None:
        """Return the state for the queue; `stopped` says whether Ctrl-C ended the trainings."""
        if not self.failure:
            return None
        return "stopped" if stopped else "not here" if self.data_missing else "failed"


class _ActiveTasks(Generic[Planned]):
    """The active tasks of a runner; errors of the runner name it."""

    def __init__(self, runner: Part, keeper: Keeper[Planned], device: str | None) -> None:
        self._part, self._keeper, self._device = runner, keeper, device
        self._runner: Runner = runner.component
        self.tasks: list[_ActiveTask[Planned]] = []

    @property
    def has_place(self) -> bool:
        """True if the runner accepts another task."""
        with self._part.at_work():
            places = self._runner.places
        return places is None or len(self.tasks) < places

    @property
    def progress(self) -> list[float]:
        """The finished share of each active task."""
        with self._part.at_work():
            return [active.progress() for active in self.tasks]

    def start(self, planned: Planned) -> None:
        task = self._keeper.task(planned, self._device)
        with self._part.at_work():
            self.tasks.append(_ActiveTask(planned, task.folder, self._runner.start(task)))

    def take_ended(self) -> list[_End[Planned]]:
        """Remove the tasks that have ended, and return their ends."""
        found = []
        for active in list(self.tasks):
            with self._part.at_work():
                if not active.task.ended:
                    continue
                failure, data_missing = active.task.failure(), active.task.data_missing
            self.tasks.remove(active)
            if not failure and not self._keeper.keep(active.planned):
                failure = (
                    "it left no results of this pipeline; has a plugin changed since the command "
                    "started?"
                )
            found.append(_End(active.planned, active.folder.name, failure, data_missing))
        return found

    def drop(self, lost: Sequence[Planned]) -> None:
        """Kill the tasks of trainings that another process has taken over."""
        for active in [active for active in self.tasks if active.planned in lost]:
            self.tasks.remove(active)
            with self._part.at_work():
                active.task.kill()

    def stop(self) -> None:
        with self._part.at_work():
            for active in self.tasks:
                active.task.stop()

    def close(self) -> None:
        """Kill the active tasks and close the runner."""
        with self._part.at_work():
            for active in self.tasks:
                active.task.kill()
            self._runner.close()


class PoolProgress:
    """Shows finished and active runs and the time left: a bar on a terminal, otherwise a line per run.

    `bar` is shown within its `with` block.
    """

    def __init__(self, total: int, console: Console) -> None:
        self._total, self._done, self._console = total, 0, console
        self.bar = Progress(
            TextColumn("{task.fields[done]}/{task.total} runs"),
            BarColumn(),
            TextColumn("{task.fields[active]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self.bar.add_task("ablation", total=total, done=0, active="")

    def ended(self, name: str, failure: str) -> None:
        """Print a line for a run that has ended; `failure` is empty if it succeeded."""
        self._done += 1
        self._console.print(f"{self._done}/{self._total}  {name}  {failure or 'finished'}")

    def show(self, parts: Sequence[float]) -> None:
        """Update the bar with the finished share of each active run."""
        if not self._console.is_terminal:
            return
        self.bar.update(
            self._task,
            completed=self._done + sum(parts),
            done=self._done,
            active=", ".join(f"{part:.0%}" for part in parts),
        )
