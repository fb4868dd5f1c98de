"""Choose a runner, and train many runs with it: for `ablate`, `bench` and the campaigns of `benchmarks/`."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
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
from registry.pipeline.yaml_source import Node, Place
from registry.runners import Runner, RunningTask, TrainingTask
from registry.system.interrupt import stop_on_interrupt

from .local_processes import LocalProcesses

Planned = TypeVar("Planned")
"""A training that is planned, for example a `PlannedRun`."""
Kept = TypeVar("Kept", contravariant=True)
LOCAL = "local"
"""Name of the default runner."""
RUNNER = next(point for point in HOOK_POINTS if point.section == "runner")
_POLL_SECONDS = 0.2
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


def train_all(
    waiting: Sequence[Planned],
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
        waiting: the unfinished trainings.
        keeper: the tasks of the trainings, and the place of their results.
        runner: from `choose_runner`.
        device: as for `--device`.
    """
    active = _ActiveTasks(runner, keeper, device)
    queue, deadline = deque(waiting), math.inf
    outcome, progress = Outcome[Planned](), PoolProgress(len(waiting), console)
    with stop_on_interrupt() as stop, progress.bar:
        try:
            while queue or active.tasks:
                if stop.requested and not outcome.stopped:
                    outcome.stopped, deadline = True, time.monotonic() + STOP_SECONDS
                    queue.clear()
                    active.stop()
                if time.monotonic() > deadline:
                    break  # `close` kills them; what they saved before stays
                while queue and active.has_place:
                    active.start(queue.popleft())
                for planned, name, failure in active.take_ended():
                    if failure and not outcome.stopped:
                        outcome.failures[planned] = failure
                    progress.ended(name, "stopped" if failure and outcome.stopped else failure)
                progress.show(active.progress)
                time.sleep(_POLL_SECONDS)
        finally:
            active.close()
    return outcome


class _ActiveTask(NamedTuple, Generic[Planned]):
    planned: Planned
    name: str
    task: RunningTask


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
            return [active.task.progress() for active in self.tasks]

    def start(self, planned: Planned) -> None:
        task = self._keeper.task(planned, self._device)
        with self._part.at_work():
            self.tasks.append(_ActiveTask(planned, task.folder.name, self._runner.start(task)))

    def take_ended(self) -> list[tuple[Planned, str, str]]:
        """Remove the tasks that have ended; return them with their names and errors, empty after success."""
        found = []
        for active in list(self.tasks):
            with self._part.at_work():
                if not active.task.ended:
                    continue
                failure = active.task.failure()
            self.tasks.remove(active)
            if not failure and not self._keeper.keep(active.planned):
                failure = (
                    "it left no results of this pipeline; has a plugin changed since the command "
                    "started?"
                )
            found.append((active.planned, active.name, failure))
        return found

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
