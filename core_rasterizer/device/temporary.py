"""Folders that last as long as this process."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path


def folder_until_exit(prefix: str) -> Path:
    """Create a folder; it is removed when this process ends, and not when its forked children do.

    Raises:
        OSError: none can be created.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    atexit.register(_remove, folder, os.getpid())
    return folder


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
