"""The runner that is used unless another is named: processes of this machine."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from functools import cached_property

from pydantic import Field

from core_rasterizer import ExplainedError
from registry import Context, Settings
from registry.pipeline import iterations_of_a_run, parse_pipeline
from registry.plugins import Plugins
from registry.runners import Runner, RunningTask, TrainingTask
from registry.runs import METRICS, RunFolder
from registry.system import write_text
from registry.training import CHECKPOINT, load_checkpoint

from .jobs import default_jobs

_TAIL_BYTES = 8192


class LocalProcessesSettings(Settings):
    jobs: int | None = Field(None, ge=1)
    """How many trainings at the same time; null: as cores and memory allow, one on a GPU."""


class LocalProcesses(Runner[LocalProcessesSettings]):
    """`stereogs train` or `resume` in processes of this machine.

    Attributes:
        lock: a file descriptor that the processes shall hold while they live, or None.
        peaks_mb: the most memory that each finished training needed.
    """

    def __init__(self, settings: LocalProcessesSettings, context: Context) -> None:
        super().__init__(settings, context)
        self.lock: int | None = None
        self.peaks_mb: list[float] = []

    @property
    def places(self) -> int:
        """As the setting says, or what the machine allows."""
        return self.settings.jobs or default_jobs(self.context.device, self.peaks_mb)

    def start(self, task: TrainingTask) -> RunningTask:
        """Start a process: anew, or from the task's checkpoint (`training_arguments`)."""
        return TrainingProcess(task, self.lock)


class TrainingProcess(RunningTask):
    """A training that has been started in a process of its own.

    Args:
        task: what to train.
        lock: a file descriptor that the child shall hold while it lives, or None.
    """

    def __init__(self, task: TrainingTask, lock: int | None) -> None:
        self._task = task
        command = [sys.executable, "-m", "registry", *training_arguments(task)]
        command += [] if task.device is None else ["--device", task.device]
        with task.log.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=() if lock is None else (lock,),
                # Of its own, so that Ctrl-C reaches it once: through `stop`.
                start_new_session=True,
            )

    @property
    def ended(self) -> bool:
        """Whether the process has come to its end."""
        return self._process.poll() is not None

    def stop(self) -> None:
        """Ask it to stop after the iteration at hand, as Ctrl-C does."""
        if not self.ended:
            self._process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)

    def kill(self) -> None:
        """End it at once and wait for that."""
        self._process.kill()
        self._process.wait()

    def progress(self) -> float:
        """The part of its iterations that it has done, as far as it has logged."""
        try:
            with (self._task.folder / METRICS).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL_BYTES))
                last = file.read().splitlines()[-1]
            done = int(json.loads(last)["iteration"])
            return done / self._iterations
        except (OSError, ValueError, KeyError, IndexError, TypeError, ZeroDivisionError):
            return 0.0  # not begun, or in the middle of a line

    @cached_property
    def _iterations(self) -> int:
        """How many the run has; its scene may have had a say in it."""
        return iterations_of_a_run(RunFolder(self._task.folder).pipeline.read_text("utf-8"))

    def failure(self) -> str:
        """What went wrong, in the child's own words; empty if nothing did."""
        return failure(
            self._process.returncode, self._task.log.read_text("utf-8", errors="replace")
        )


def failure(status: int | None, printed: str) -> str:
    """What a training's exit status and what it printed say went wrong; empty if nothing did."""
    if status == 0:
        return ""
    if status is not None and status < 0:
        return f"it was ended by signal {-status}; was there enough memory?"
    lines = printed.splitlines()
    starts = [i for i, line in enumerate(lines) if line.startswith("stereogs: ")]
    return "\n".join(lines[starts[-1] :] if starts else lines[-1:]) or f"exit status {status}"


def training_arguments(task: TrainingTask) -> list[str]:
    """What `stereogs` is told: go on from the run's checkpoint if it has a usable one, else anew.

    For a new start, what lies there is removed and the pipeline is written beside the folder.
    """
    if _can_resume(task):
        return ["resume", str(task.folder)]
    if task.folder.exists():
        shutil.rmtree(task.folder)
    pipeline = task.folder.with_name(f"{task.folder.name}.yaml")
    write_text(pipeline, task.pipeline)
    return ["train", str(pipeline), "--out", str(task.folder)]


def _can_resume(task: TrainingTask) -> bool:
    run = RunFolder(task.folder)
    try:
        text = run.pipeline.read_text("utf-8")
        load_checkpoint(run.path / CHECKPOINT)
        # Only a pipeline whose length follows the scene has to be understood for that.
        return text == task.pipeline or parse_pipeline(task.pipeline, Plugins()).wrote(text)
    except (OSError, UnicodeDecodeError, ExplainedError):
        return False
