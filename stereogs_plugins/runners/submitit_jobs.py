"""`submitit`: train as jobs of Slurm, or of this machine to try it (extra `slurm`).

The output folder must be on a file system that all machines share.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Context, Register, Settings, hookimpl
from registry.runners import DATA_MISSING, WORKER, Runner, RunningTask, failure
from registry.toolkit import optional_module

if TYPE_CHECKING:
    from registry.runners import TrainingTask

_POLL_SECONDS = 0.2


class SubmititSettings(Settings):
    cluster: str | None = None
    """"slurm", or "local" for processes of this machine; null: Slurm where it is installed."""
    jobs: int | None = Field(None, ge=1)
    """Number of jobs that run or wait in the queue at the same time; null: all."""
    cores: int = Field(4, ge=1)
    """CPU cores per training."""
    gpus: int = Field(0, ge=0)
    """GPUs per training."""
    memory_mb: float = Field(4000, gt=0, allow_inf_nan=False)
    """Memory per training, which Slurm reserves and enforces."""
    minutes: int = Field(60, ge=1)
    """Time limit of a job. One that reaches it saves a checkpoint and is queued again."""
    partition: str | None = None
    """Slurm's partition; null: its default."""


class Training:
    """The work of a job; submitit sends it to the machine of the job.

    Args:
        command: arguments of Python.
        log: file for the output.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        self.command, self.log = command, log
        self._process: subprocess.Popen[bytes] | None = None

    def __call__(self) -> tuple[int, str]:
        """Train; return the exit status and the name of the machine."""
        with self.log.open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, *self.command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Slurm's signals before the time limit would kill it
            )
        self._process = process

        def forward(number: int, frame: FrameType | None) -> None:
            process.send_signal(number)

        signal.signal(signal.SIGTERM, forward)
        while process.poll() is None:
            time.sleep(_POLL_SECONDS)
        return process.returncode, socket.gethostname()

    def checkpoint(self) -> Any:
        """Stop before the time limit or a preemption; return what Slurm queues again."""
        import submitit

        if self._process is not None:
            self._process.terminate()
            self._process.wait()
            self._process = None
        return submitit.helpers.DelayedSubmission(self)


class Submitit(Runner[SubmititSettings]):
    """Trainings as jobs of a cluster that submitit knows.

    Every machine needs the same version of this package and the plugins used by the pipelines. A job whose
    data is missing on a machine is sent to another.

    Raises:
        PluginError: submitit is not installed.
    """

    def __init__(self, settings: SubmititSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._submitit = optional_module(
            "submitit", "pip install 'stereogs-plugins[slurm]'", then=""
        )
        self.refused: type[Exception] = self._submitit.core.utils.FailedJobError
        """Raised if no machine is left for a job."""

    @property
    def places(self) -> int | None:
        """The number of jobs at the same time; None: all."""
        return self.settings.jobs

    def start(self, task: TrainingTask) -> RunningTask:
        """Submit a job."""
        pipeline = task.folder.absolute().with_name(f"{task.folder.name}.yaml")
        pipeline.write_text(task.pipeline, "utf-8")
        command = ["-m", WORKER, str(pipeline), str(task.folder.absolute())]
        command += [] if task.device is None else ["--device", task.device]
        return _Job(self, Training(command, task.log.absolute()), task)

    def submit(self, training: Training, task: TrainingTask, without: set[str]) -> Any:
        """Submit a training; `without` names machines not to use."""
        asked = self.settings
        executor = self._submitit.AutoExecutor(
            folder=task.folder.absolute().parent.with_name("jobs"), cluster=asked.cluster
        )
        options: dict[str, Any] = {
            "name": "stereogs",
            "timeout_min": asked.minutes,
            "cpus_per_task": asked.cores,
            "gpus_per_node": asked.gpus,
            "mem_gb": asked.memory_mb / 1000,
        }
        if asked.partition is not None:
            options["slurm_partition"] = asked.partition
        if without:
            options["slurm_exclude"] = ",".join(sorted(without))
        executor.update_parameters(**options)
        return executor.submit(training)


class _Job(RunningTask):
    def __init__(self, runner: Submitit, training: Training, task: TrainingTask) -> None:
        self._runner, self._training, self._task = runner, training, task
        self._without: set[str] = set()
        self._job = runner.submit(training, task, self._without)
        self._failure: str | None = None
        self._status, self._stopped = 0, False

    @property
    def ended(self) -> bool:
        if self._failure is None and self._job.done():
            # submitit waits for an answer, which a cancelled job does not give.
            self._failure = "stopped" if self._stopped else self._received()
        return self._failure is not None

    def _received(self) -> str | None:
        """Return the error, empty after success; None if the job was sent to another machine."""
        error = self._job.exception()
        if error is not None:
            return f"job {self._job.job_id}: {str(error).splitlines()[-1]}"
        self._status, machine = self._job.result()
        if self._status == DATA_MISSING and machine not in self._without:
            self._without.add(machine)
            with suppress(self._runner.refused):
                self._job = self._runner.submit(self._training, self._task, self._without)
                return None
        return failure(self._status, self._task.log.read_text("utf-8", errors="replace"))

    @property
    def data_missing(self) -> bool:
        return self._status == DATA_MISSING

    def failure(self) -> str:
        return self._failure or ""

    def stop(self) -> None:
        self._stopped = True
        self._job.cancel(check=False)

    def kill(self) -> None:
        self._job.cancel(check=False)


@hookimpl
def stereogs_register_runners(register: Register[Submitit]) -> None:
    register("submitit", Submitit)
