"""Choose a runner and train the unfinished runs of a plan with it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from core_rasterizer import Device
from registry.contract.hook_points import HOOK_POINTS, HookPoint
from registry.discovery import Offer, Plugins
from registry.errors import PipelineError
from registry.pipeline.edits import expand
from registry.pipeline.parts import Part, build_part
from registry.pipeline.pipeline import component_item
from registry.pipeline.yaml_source import Node, Place
from registry.runners import Runner, RunningTask, TrainingTask
from registry.system.interrupt import stop_on_interrupt

from ..planning.plan import PlannedRun
from .folder import AblationFolder
from .local_processes import LocalProcesses

LOCAL = "local"
"""Name of the default runner."""
RUNNER = next(point for point in HOOK_POINTS if point.section == "runner")
_POLL_SECONDS = 0.2


def choose_runner(written: Node | None, jobs: int | None, plugins: Plugins, device: Device) -> Part:
    """Build a runner.

    Args:
        written: a component as in a pipeline; None for `local`.
        jobs: replaces the setting `jobs` of `local`.

    Raises:
        PipelineError: invalid settings, or `jobs` with another runner than `local`.
        PluginError: no plugin offers the runner, or it cannot be loaded or built.
    """

    def find(point: HookPoint, name: str) -> Offer:
        if name != LOCAL:
            return plugins.find(point, name)
        package = "stereogs-plugins"
        return Offer(point, LOCAL, LocalProcesses, "registry", package, version(package))

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


@dataclass
class Outcome:
    """The outcome of `train_all`: whether Ctrl-C stopped it, and the error of each failed run."""

    stopped: bool = False
    failures: dict[PlannedRun, str] = field(default_factory=dict)


def train_all(
    waiting: Sequence[PlannedRun],
    folder: AblationFolder,
    runner: Part,
    *,
    device: str | None,
    console: Console,
) -> Outcome:
    """Train runs in order, as many at a time as the runner allows.

    If a run fails, the others are still trained. The first Ctrl-C stops the active runs and waits for them; a
    second one kills them.

    Args:
        waiting: the unfinished runs.
        runner: from `choose_runner`.
        device: as for `--device`.
    """
    active = _ActiveRuns(runner, folder, device)
    queue = deque(waiting)
    outcome, progress = Outcome(), AblationProgress(len(waiting), console)
    with stop_on_interrupt() as stop, progress.bar:
        try:
            while queue or active.runs:
                if stop.requested and not outcome.stopped:
                    outcome.stopped = True
                    queue.clear()
                    active.stop()
                while queue and active.has_place:
                    active.start(queue.popleft())
                for planned, failure in active.take_ended():
                    if failure and not outcome.stopped:
                        outcome.failures[planned] = failure
                    name = folder.run(planned).path.name
                    progress.ended(name, "stopped" if failure and outcome.stopped else failure)
                progress.show(active.progress)
                time.sleep(_POLL_SECONDS)
        finally:
            active.close()
    return outcome


class _ActiveRun(NamedTuple):
    planned: PlannedRun
    task: RunningTask


class _ActiveRuns:
    """The active tasks of a runner; errors of the runner name it."""

    def __init__(self, runner: Part, folder: AblationFolder, device: str | None) -> None:
        self._part, self._folder, self._device = runner, folder, device
        self._runner: Runner = runner.component
        self.runs: list[_ActiveRun] = []

    @property
    def has_place(self) -> bool:
        """True if the runner accepts another task."""
        with self._part.at_work():
            places = self._runner.places
        return places is None or len(self.runs) < places

    @property
    def progress(self) -> list[float]:
        """The finished share of each active run."""
        with self._part.at_work():
            return [run.task.progress() for run in self.runs]

    def start(self, planned: PlannedRun) -> None:
        path = self._folder.run(planned).path
        log = path.with_name(f"{path.name}.log")
        task = TrainingTask(planned.pipeline.to_yaml(), path, log, self._device)
        with self._part.at_work():
            self.runs.append(_ActiveRun(planned, self._runner.start(task)))

    def take_ended(self) -> list[tuple[PlannedRun, str]]:
        """Remove and return the runs that have ended, with their errors; empty if they succeeded."""
        found = []
        for run in list(self.runs):
            with self._part.at_work():
                if not run.task.ended:
                    continue
                failure = run.task.failure()
            self.runs.remove(run)
            if not failure and not self._folder.results(run.planned):
                failure = (
                    "it left no results of this pipeline; has a plugin changed since the command "
                    "started?"
                )
            found.append((run.planned, failure))
        return found

    def stop(self) -> None:
        with self._part.at_work():
            for run in self.runs:
                run.task.stop()

    def close(self) -> None:
        """Kill the active runs and close the runner."""
        with self._part.at_work():
            for run in self.runs:
                run.task.kill()
            self._runner.close()


class AblationProgress:
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
