"""Runners of independent trainings, for example on a cluster."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from .contract.component import Component, SettingsType

__all__ = ["DATA_MISSING", "WORKER", "Runner", "RunningTask", "TrainingTask", "failure"]

WORKER = "stereogs.experiments.running.worker"
"""`python -m WORKER PIPELINE RUN [--device NAME]` trains a pipeline file in a run folder, or resumes it.

Exit status: 0 finished; 130 stopped by SIGINT or SIGTERM, with a checkpoint; `DATA_MISSING`; others failed.
"""
DATA_MISSING = 66
"""Exit status: files or folders that the pipeline names are not on this machine; another may have them."""


@dataclass(frozen=True)
class TrainingTask:
    """One training, independent of others.

    Args:
        pipeline: complete YAML; equal pipelines give equal bits on equal devices.
        folder: the run folder to write. If it holds a stopped run of this pipeline, the runner resumes or
            replaces it.
        log: file for the training's output.
        device: part of a device's name, as for `--device`; None: each machine chooses.
    """

    pipeline: str
    folder: Path
    log: Path
    device: str | None = None


class RunningTask(ABC):
    """A task that a runner has started."""

    @property
    @abstractmethod
    def ended(self) -> bool:
        """Whether it has ended, successfully or not; returns immediately."""

    @abstractmethod
    def failure(self) -> str:
        """Return the training's error message after its end; empty if it succeeded."""

    @property
    def data_missing(self) -> bool:
        """Whether it failed because the machine lacks data that others may have."""
        return False

    @abstractmethod
    def stop(self) -> None:
        """Request its end within eight seconds, with a checkpoint if possible."""

    @abstractmethod
    def kill(self) -> None:
        """End it immediately, and wait for the end."""

    def progress(self) -> float:
        """Return the share of its iterations that is complete; 0 to read it from the run folder."""
        return 0.0


class Runner(Component[SettingsType], ABC):
    """Runs independent trainings, on this machine or on others."""

    @property
    def places(self) -> int | None:
        """Number of tasks that can run at the same time; None: it takes and queues all tasks."""
        return None

    @abstractmethod
    def start(self, task: TrainingTask) -> RunningTask:
        """Start a task, or queue it; return immediately."""

    def close(self) -> None:
        """Release resources, such as a connection to a cluster."""


def failure(status: int | None, printed: str) -> str:
    """Return the error of a training with this exit status and output; empty if it succeeded."""
    if status == 0:
        return ""
    if status is not None and status < 0:
        return f"it was killed by signal {-status}; was there enough memory?"
    lines = printed.splitlines()
    starts = [i for i, line in enumerate(lines) if line.startswith("stereogs: ")]
    return "\n".join(lines[starts[-1] :] if starts else lines[-1:]) or f"exit status {status}"
