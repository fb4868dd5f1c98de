"""Process one share in a separate process, isolated from crashes and hangs."""

from __future__ import annotations

import faulthandler
import logging
import os
import tempfile
import warnings
from pathlib import Path

from tests.fuzzing.formats import TARGETS
from tests.fuzzing.fuzz import Tally, folder_for, fuzz
from tests.fuzzing.target import Target

HANGS = 60
"""Seconds after which a reader counts as hanging and its process is ended."""
IN_MEMORY = Path("/dev/shm")
_targets: dict[str, Target] = {}
_folder: tempfile.TemporaryDirectory[str] | None = None


def work(name: str, first: int, stop: int, state: Path) -> Tally:
    """Fuzz a target with the numbers from `first` to `stop - 1`.

    Args:
        state: Folder for a file per process that holds the number in progress.
    """
    note = state / f"{os.getpid()}.reading"

    def starts(number: int) -> None:
        note.write_text(f"{name}\n{number}")
        faulthandler.dump_traceback_later(HANGS, exit=True)

    try:
        return fuzz(_target(name), range(first, stop), starts)
    finally:
        faulthandler.cancel_dump_traceback_later()
        note.unlink(missing_ok=True)


def _target(name: str) -> Target:
    """Return the target, created once per process, on a RAM disk if available."""
    global _folder
    if _folder is None:
        os.environ["STEREOGS_CACHE"] = ""
        warnings.simplefilter("ignore")
        logging.disable(logging.ERROR)
        _folder = tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None)
    if name not in _targets:
        _targets[name] = TARGETS[name](folder_for(name, Path(_folder.name)))
    return _targets[name]
