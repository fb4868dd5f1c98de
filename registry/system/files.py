"""Atomic writes: files are written under a temporary name, flushed and renamed."""

from __future__ import annotations

import glob
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from ..messages.visible_text import visible

_LEFTOVER = re.compile(r"\..+\.(?P<process>[0-9]+)\.partial")
"""Temporary names: the final name and the number of the writing process."""
_TRIES = 20


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, and rename it to `path` after the block.

    If the block raises, the temporary file is removed and `path` stays unchanged.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield temporary
        flush(temporary)
        _replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _replace(source: Path, target: Path) -> None:
    """Replace a file by another; on Windows try for a second, as a process that reads `target` locks it."""
    for _ in range(_TRIES if sys.platform == "win32" else 0):
        with suppress(PermissionError):
            source.replace(target)
            return
        time.sleep(1 / _TRIES)
    source.replace(target)


def flush(file: Path) -> None:
    """Write a file's buffers to the disk."""
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())


def flush_folder(folder: Path) -> None:
    """Write a folder's entries, and so the renames in it, to the disk; not on Windows."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, with the same bytes on all systems, as `replacing` does."""
    with replacing(path) as temporary:
        temporary.write_text(text, "utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON; keys keep their order."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def jsonable(value: Any) -> Any:
    """Convert to plain values: infinities and NaN to None, control characters in texts to escapes."""
    return _visible(to_jsonable_python(value, inf_nan_mode="null"))


def _visible(value: Any) -> Any:
    if isinstance(value, dict):
        return {visible(str(key)): _visible(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_visible(inner) for inner in value]
    return visible(value) if isinstance(value, str) else value


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path`, and rename it to `path` after the block.

    If the block raises, the folder is removed. Parent folders are created. `path` must not exist, or be an
    empty folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        prefix=f".{path.name}.",
        suffix=f".{os.getpid()}.partial",
        dir=path.parent,
        ignore_cleanup_errors=True,
    ) as temporary:
        inside = Path(temporary, "inside")  # TemporaryDirectory's own folder is private (mode 700)
        inside.mkdir()
        yield inside
        if sys.platform == "win32":  # which renames to no folder that exists
            with suppress(FileNotFoundError):
                path.rmdir()
        inside.rename(path)


def remove_leftovers(folder: Path, of: str = "") -> None:
    """Remove temporary files and folders of processes that no longer run.

    Args:
        of: only those for the file or folder of this name.
    """
    for path in folder.glob(f".{glob.escape(of)}*.partial"):
        found = _LEFTOVER.fullmatch(path.name)
        if found is None or _is_alive(int(found["process"])):
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    if os.name != "posix":  # where signal 0 is a Ctrl-C
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # another user's
        return True
    return True
