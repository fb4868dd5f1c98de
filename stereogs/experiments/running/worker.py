"""`python -m stereogs.experiments.running.worker PIPELINE RUN [OPTION ...]`: the process of one training.

Resumes a run that has a usable checkpoint, otherwise trains it from scratch; options are those of both verbs.
If the process that started it ends, also by SIGKILL, it saves a checkpoint and ends. Every runner starts it.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from core_rasterizer.errors import ExplainedError
from registry.errors import RunError
from registry.runners import DATA_MISSING
from registry.system.lock import locked

from ...cli import main
from ...command_line.output import INTERRUPTED
from ...verbs.train import collector_at_rest

with collector_at_rest():
    from registry.discovery import Plugins
    from registry.pipeline.pipeline import Pipeline, parse_pipeline
    from registry.pipeline.settings_check import paths_of
    from registry.runs.folder import RunFolder
    from registry.training.checkpoint import CHECKPOINT, load_checkpoint

WAIT_SECONDS = 15.0
"""How long to wait for a process that saves a checkpoint of this run because its parent was killed."""
_PARENT_DEATH = 1
"""PR_SET_PDEATHSIG of Linux' prctl(2)."""


def train(pipeline: Path, run: Path, options: Sequence[str]) -> int:
    """Train; return the exit status of `stereogs`, or `DATA_MISSING`."""
    wait_until_free(run)
    status = main([*training_arguments(pipeline, run), *options])
    if status in (0, INTERRUPTED):
        return status
    missing = missing_paths(parse_pipeline(pipeline.read_text("utf-8"), Plugins()))
    if not missing:
        return status
    print(f"  not on this machine: {', '.join(map(str, missing))}", file=sys.stderr)
    return DATA_MISSING


def training_arguments(pipeline: Path, run: Path) -> list[str]:
    """Return arguments that resume a run if it has a usable checkpoint, otherwise remove it and train."""
    if _can_resume(pipeline.read_text("utf-8"), RunFolder(run)):
        return ["resume", str(run)]
    if run.exists():
        shutil.rmtree(run)
    return ["train", str(pipeline), "--out", str(run)]


def missing_paths(pipeline: Pipeline) -> list[Path]:
    """Return the files and folders in the settings of a pipeline that do not exist on this machine."""
    named = (path for item in pipeline for path, _ in paths_of(item.settings))
    return [path for path in named if not path.exists()]


def wait_until_free(run: Path) -> None:
    """Wait until no other process uses a run folder, at most `WAIT_SECONDS`."""
    end = time.monotonic() + WAIT_SECONDS
    while run.is_dir() and time.monotonic() < end:
        try:
            with locked(run):
                return
        except RunError:
            time.sleep(0.5)


def end_with_parent() -> None:
    """Receive SIGTERM when the parent has ended; only on Linux."""
    if sys.platform == "linux":
        parent = os.getppid()
        ctypes.CDLL(None).prctl(_PARENT_DEATH, signal.SIGTERM)
        if os.getppid() != parent:
            os.kill(os.getpid(), signal.SIGTERM)


def _can_resume(text: str, run: RunFolder) -> bool:
    try:
        written = run.pipeline.read_text("utf-8")
        load_checkpoint(run.path / CHECKPOINT)
        # The texts differ if the length of the run depends on its scene.
        return written == text or parse_pipeline(text, Plugins()).wrote(written)
    except (OSError, UnicodeDecodeError, ExplainedError):
        return False


if __name__ == "__main__":
    end_with_parent()
    sys.exit(train(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]))
