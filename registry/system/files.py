"""Files that are complete or absent: written beside their place, flushed, then renamed."""

from __future__ import annotations

import glob
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_LEFTOVER = re.compile(r"\..+\.(?P<process>[0-9]+)\.partial")
"""What temporary files and folders are called: after what they become, and who writes them."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder; on success it takes the place of `path`.

    If the block raises, the temporary file is removed and `path` stays what it was.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield temporary
        flush(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def flush(file: Path) -> None:
    """Have the disk hold what was written to a file."""
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())


def flush_folder(folder: Path) -> None:
    """Have the disk hold a folder's list of files, and with it the renames in it; not on Windows."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8: whole, or `path` stays what it was."""
    with replacing(path) as temporary:
        temporary.write_text(text, "utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write JSON that a person can read; keys keep their order."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def jsonable(value: Any) -> Any:
    """Plain values with infinities and not-a-numbers as None."""
    if isinstance(value, dict):
        return {key: jsonable(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(child) for child in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder beside `path`; on success it becomes `path`, else it vanishes.

    Parent folders are created. `path` must not exist, or be an empty folder.
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
        inside.rename(path)


def remove_leftovers(folder: Path, of: str = "") -> None:
    """Remove what processes that were killed had begun to write; what living ones write stays.

    Args:
        of: only what would have become the file or folder of this name.
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
    except OSError:  # somebody else's
        return True
    return True
