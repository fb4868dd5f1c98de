"""Room in the cache: once it holds more than it may, what was not used for the longest time goes.

Only folders that look like entries are ever removed, so that a cache folder that holds something else
too, a home folder for example, loses nothing.
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
"""The file that marks a folder as an entry."""
SHARE_KEPT = 0.9
"""Of the limit, once it is passed: so not every new entry must look through the whole cache."""
ABANDONED = 24 * 3600
"""Seconds after which an unfinished entry belongs to nobody who still runs."""
_ENTRY = re.compile(r"[0-9a-f]{32}")
_UNFINISHED = re.compile(r"\.[0-9a-f]{32}\..*\.partial")

_lock = threading.Lock()
_sizes: dict[Path, int] = {}
"""Bytes by cache folder, as counted when it was last looked through, and added to by this process since."""


class Entry(NamedTuple):
    """One entry, as found: when it was last used (seconds), and its size in bytes."""

    used: float
    path: Path
    size: int


def make_room(root: Path, newest: Path) -> None:
    """Remove the least recently used entries if the cache is too large; the newest always stays.

    Args:
        root: folder of the whole cache.
        newest: the entry that was just written.

    Raises:
        RunError: STEREOGS_CACHE_MB is no positive whole number.
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
    """Remove entries, the least recently used first; return the bytes that are left."""
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
    """Remove an entry, at once for whoever looks for it; False if that is not possible."""
    leaving = path.with_name(f".{path.name}.leaving.partial")
    try:
        path.rename(leaving)
    except OSError:  # another process removes it, or it cannot be removed
        return False
    shutil.rmtree(leaving, ignore_errors=True)
    return True


def _remove_abandoned(root: Path) -> None:
    """What killed processes had begun to write; by its age, because other machines may write here too."""
    for path in root.glob("*/.*.partial"):
        if _UNFINISHED.fullmatch(path.name) and time.time() - _used(path) > ABANDONED:
            shutil.rmtree(path, ignore_errors=True)


def _entries(root: Path) -> list[Entry]:
    found = (path for path in root.glob("*/*") if _ENTRY.fullmatch(path.name))
    return [Entry(_used(p), p, _size(p)) for p in found if (p / CHECKSUM).is_file()]


def _used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # gone meanwhile
        return 0.0


def _size(folder: Path) -> int:
    total = 0
    for place, _, names in os.walk(folder):  # which passes over folders that are gone meanwhile
        for name in names:
            with suppress(FileNotFoundError):
                total += Path(place, name).stat().st_size
    return total
