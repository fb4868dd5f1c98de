"""The default runner: processes on this machine."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence

from pydantic import Field

from core_rasterizer import Device
from registry import Context, Settings
from registry.runners import DATA_MISSING, WORKER, Runner, RunningTask, TrainingTask, failure
from registry.system.cores import usable_cores
from registry.system.files import write_text
from registry.system.memory import available_bytes

CORES_PER_RUN = 4
"""A training uses about so many cores; more trainings on fewer cores save no time."""
MEMORY_PER_RUN_MB = 2000.0
"""Assumed memory of a training until one has been measured."""


class LocalProcessesSettings(Settings):
    jobs: int | None = Field(None, ge=1)
    """Number of simultaneous trainings; null: as many as cores and memory allow, 1 on a GPU."""


class LocalProcesses(Runner[LocalProcessesSettings]):
    """Trains in processes on this machine.

    Attributes:
        lock: file descriptor that the processes inherit, or None.
        peaks_mb: peak memory of each finished training.
    """

    def __init__(self, settings: LocalProcessesSettings, context: Context) -> None:
        super().__init__(settings, context)
        self.lock: int | None = None
        self.peaks_mb: list[float] = []

    @property
    def places(self) -> int:
        """The number of simultaneous trainings."""
        return self.settings.jobs or default_jobs(self.context.device, self.peaks_mb)

    def start(self, task: TrainingTask) -> RunningTask:
        """Start a process for the task (see `worker`)."""
        pipeline = task.folder.with_name(f"{task.folder.name}.yaml")
        write_text(pipeline, task.pipeline)
        return TrainingProcess(task, [WORKER, str(pipeline), str(task.folder)], self.lock)


def default_jobs(device: Device, peaks_mb: Iterable[float]) -> int:
    """Return how many trainings cores and free memory allow; 1 on a GPU or if the memory is unknown.

    Args:
        peaks_mb: peak memory of finished trainings.
    """
    if device.kind != "cpu":
        return 1
    by_cores = usable_cores() // CORES_PER_RUN
    free = available_bytes()
    if math.isinf(free):  # unknown
        return 1
    by_memory = int(free / 1e6 // max(peaks_mb, default=MEMORY_PER_RUN_MB))
    return max(1, min(by_cores, by_memory))


class TrainingProcess(RunningTask):
    """A training in its own process.

    Args:
        module: of Python, which trains, and its arguments.
        lock: file descriptor that the process inherits, or None.
        environment: variables to change.
    """

    def __init__(
        self,
        task: TrainingTask,
        module: Sequence[str],
        lock: int | None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._task = task
        command = [sys.executable, "-m", *module]
        command += [] if task.device is None else ["--device", task.device]
        with task.log.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | (environment or {}),
                pass_fds=() if lock is None else (lock,),
                # Ctrl-C in the terminal does not reach the new session; `stop` forwards it once.
                start_new_session=True,
            )

    @property
    def ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def stop(self) -> None:
        """Ask the process to stop after the current iteration, as Ctrl-C does."""
        if not self.ended:
            self._process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self._process.kill()
        self._process.wait()

    @property
    def data_missing(self) -> bool:
        """Whether the process found that data is missing."""
        return self._process.returncode == DATA_MISSING

    def failure(self) -> str:
        """Return the error that the process printed; empty if it succeeded."""
        return failure(
            self._process.returncode, self._task.log.read_text("utf-8", errors="replace")
        )
