"""One run of an ablation: `stereogs train` or `resume` in a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys

from ...errors import RunError
from ...runs.folder import METRICS, RunFolder
from ...system.files import write_text
from ...training.checkpoint import CHECKPOINT, load_checkpoint
from ..planning.plan import PlannedRun

_TAIL_BYTES = 8192


class TrainingProcess:
    """A training that has been started: anew, or from its checkpoint (`training_arguments`).

    Args:
        planned: what to train.
        run: its folder.
        device: part of the device's name, as for `--device`; None lets the child choose.
        lock: a file descriptor that the child shall hold while it lives, or None.
    """

    def __init__(
        self, planned: PlannedRun, run: RunFolder, *, device: str | None, lock: int | None
    ) -> None:
        self.planned, self.run = planned, run
        self.log = run.path.with_name(f"{run.path.name}.log")
        command = [sys.executable, "-m", "registry", *training_arguments(planned, run)]
        command += [] if device is None else ["--device", device]
        with self.log.open("wb") as log:
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
            with (self.run.path / METRICS).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL_BYTES))
                last = file.read().splitlines()[-1]
            done = int(json.loads(last)["iteration"])
        except (OSError, ValueError, KeyError, IndexError, TypeError):
            return 0.0  # not begun, or in the middle of a line
        return done / self.planned.pipeline.training.iterations

    def failure(self) -> str:
        """What went wrong, in the child's own words; empty if nothing did."""
        status = self._process.returncode
        if status == 0:
            return ""
        if status is not None and status < 0:
            return f"it was ended by signal {-status}; was there enough memory?"
        lines = self.log.read_text("utf-8", errors="replace").splitlines()
        starts = [i for i, line in enumerate(lines) if line.startswith("stereogs: ")]
        return "\n".join(lines[starts[-1] :] if starts else lines[-1:]) or f"exit status {status}"


def training_arguments(planned: PlannedRun, run: RunFolder) -> list[str]:
    """What `stereogs` is told: go on from the run's checkpoint if it has a usable one, else anew.

    For a new start, what lies there is removed and the pipeline is written beside the folder.
    """
    if _can_resume(planned, run):
        return ["resume", str(run.path)]
    if run.path.exists():
        shutil.rmtree(run.path)
    pipeline = run.path.with_name(f"{run.path.name}.yaml")
    write_text(pipeline, planned.pipeline.to_yaml())
    return ["train", str(pipeline), "--out", str(run.path)]


def _can_resume(planned: PlannedRun, run: RunFolder) -> bool:
    try:
        same = run.pipeline.read_text("utf-8") == planned.pipeline.to_yaml()
        load_checkpoint(run.path / CHECKPOINT)
    except (OSError, UnicodeDecodeError, RunError):
        return False
    return same
