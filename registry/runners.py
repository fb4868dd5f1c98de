"""Runners: where trainings run that do not depend on each other, such as a cluster."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from .contract.component import Component, SettingsType

__all__ = ["Runner", "RunningTask", "TrainingTask"]


@dataclass(frozen=True)
class TrainingTask:
    """One training that depends on no other: files in, a run folder out.

    Args:
        pipeline: YAML, complete; equal pipelines give equal bits on equal devices, wherever they run.
        folder: where the finished run folder is to lie. It may hold a run of this pipeline that was
            stopped; a runner that does not go on with it puts a whole one in its place.
        log: the file for what the training prints.
        device: part of a device's name, as for `--device`; None: each machine chooses.
    """

    pipeline: str
    folder: Path
    log: Path
    device: str | None = None


class RunningTask(ABC):
    """A task that a runner has begun."""

    @property
    @abstractmethod
    def ended(self) -> bool:
        """Whether it has come to its end, well or not; returns at once."""

    @abstractmethod
    def failure(self) -> str:
        """After its end: what went wrong, in the training's own words; empty if nothing did."""

    @abstractmethod
    def stop(self) -> None:
        """Ask it to end soon; what it has done may be kept or lost."""

    @abstractmethod
    def kill(self) -> None:
        """End it at once, if it has not ended, and wait for that."""

    def progress(self) -> float:
        """The share of its iterations that is done, as far as it is known."""
        return 0.0


class Runner(Component[SettingsType], ABC):
    """Carries out trainings that do not depend on each other: here, or on other machines."""

    @property
    def places(self) -> int | None:
        """How many tasks it takes at the same time; None: all there are, and queues them itself."""
        return None

    @abstractmethod
    def start(self, task: TrainingTask) -> RunningTask:
        """Begin a task, or queue it; returns at once."""

    def close(self) -> None:
        """Let go of what it holds, such as a connection to a cluster."""
