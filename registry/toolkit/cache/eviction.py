"""Limit the size of the cache: remove the least recently used entries.

Only folders that look like entries are removed, so that other files in the cache folder, for example a
home folder, are safe.
"""

from __future__ import annotations

import os
import re
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from .place import size_limit

CHECKSUM = "checksum.txt"
"""File that marks a folder as an entry."""
SHARE_KEPT = 0.9
"""Share of the limit to keep when it is exceeded, so that not every new entry scans the whole cache."""
ABANDONED = 24 * 3600
"""Seconds after which the process that writes an unfinished entry is assumed dead."""
_ENTRY = re.compile(r"[0-9a-f]{32}")
_UNFINISHED = re.compile(r"\.[0-9a-f]{32}\..*\.partial")

_lock = threading.Lock()
_sizes: dict[Path, int] = {}
"""Bytes by cache folder: counted at the last scan, plus entries that this process has added."""


class Entry(NamedTuple):
    """An entry: time of last use in seconds, path, size in bytes."""

    used: float
    path: Path
    size: int


def make_room(root: Path, newest: Path) -> None:
    """Remove the least recently used entries if the cache is too large, but never the newest.

    Args:
        root: Folder of the whole cache.
        newest: Entry that was just written.

    Raises:
        RunError: STEREOGS_CACHE_MB is not a positive integer.
    """
    limit = size_limit()
    with _lock:
        if root in _sizes:
            _sizes[root] += _size(newest)
        else:
            _remove_abandoned(root)
            _sizes[root] = sum(entry.size for entry in _entries(root))
        if _sizes[root] > limit:
            _sizes[root] = _evict(root, newest, SHARE_KEPT * limit)


def _evict(root: Path, newest: Path, wanted: float) -> int:
    """Remove entries, least recently used first; return the remaining bytes."""
    _remove_abandoned(root)
    entries = sorted(_entries(root))
    total = sum(entry.size for entry in entries)
    for entry in entries:
        if total <= wanted:
            break
        if entry.path != newest and _remove(entry.path):
            total -= entry.size
    return total


def _remove(path: Path) -> bool:
    """Remove an entry atomically for other processes; return False if that fails."""
    leaving = path.with_name(f".{path.name}.leaving.partial")
    try:
        path.rename(leaving)
    except OSError:  # removed by another process, or not removable
        return False
    shutil.rmtree(leaving, ignore_errors=True)
    return True


def _remove_abandoned(root: Path) -> None:
    """Remove old unfinished entries; age decides, because other machines may write here too."""
    for path in root.glob("*/.*.partial"):
        if _UNFINISHED.fullmatch(path.name) and time.time() - _used(path) > ABANDONED:
            shutil.rmtree(path, ignore_errors=True)


def _entries(root: Path) -> list[Entry]:
    found = (path for path in root.glob("*/*") if _ENTRY.fullmatch(path.name))
    return [Entry(_used(p), p, _size(p)) for p in found if (p / CHECKSUM).is_file()]


def _used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # removed meanwhile
        return 0.0


def _size(folder: Path) -> int:
    total = 0
    for place, _, names in os.walk(folder):  # skips folders that were removed meanwhile
        for name in names:
            with suppress(FileNotFoundError):
                total += Path(place, name).stat().st_size
    return total
