"""Entries of the cache: folders that are either complete or absent.

    STEREOGS_CACHE/<kind>/<key>/    the saved files
                     checksum.txt   hash of the files; detects entries damaged by crashes or disk errors

An entry is written to a temporary folder, which is then renamed. If two processes write the same entry, the
first one wins. The least recently used entries are removed when the cache is too large. Only folders that
look like entries are removed, so that other files in the cache folder, for example a home folder, are safe.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import re
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from ...errors import RunError
from ...system.files import new_folder

if TYPE_CHECKING:
    from collections.abc import Callable

FOLDER_VARIABLE = "STEREOGS_CACHE"
"""Environment variable with the cache's folder; empty disables the cache."""
CHECKSUM = "checksum.txt"
"""File that marks a folder as an entry."""
SIZE_VARIABLE = "STEREOGS_CACHE_MB"
"""Environment variable with the size limit in megabytes (1,000,000 bytes)."""
DEFAULT_MEGABYTES = 5000
SHARE_KEPT = 0.9
"""Share of the limit to keep when it is exceeded, so that not every new entry scans the whole cache."""
ABANDONED = 24 * 3600
"""Seconds after which the process that writes an unfinished entry is assumed dead."""
_ENTRY = re.compile(r"[0-9a-f]{32}")
_UNFINISHED = re.compile(r"\.[0-9a-f]{32}\..*\.partial")
_lock = threading.Lock()
_sizes: dict[Path, int] = {}
"""Bytes by cache folder: counted at the last scan, plus entries that this process has added."""

Answer = TypeVar("Answer")
_ANOTHER_WAS_FIRST = (errno.EEXIST, errno.ENOTEMPTY)
_log = logging.getLogger(__name__)


class Cache:
    """All entries of one kind; `kind` names their folder, for example after the plugin."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    @property
    def folder(self) -> Path | None:
        """Folder of the entries; None if STEREOGS_CACHE disables caching."""
        named = os.environ.get(FOLDER_VARIABLE)
        if named is None:
            home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
            return Path(home) / "stereogs" / self.kind
        return Path(named) / self.kind if named else None

    def load(self, key: str, read: Callable[[Path], Answer]) -> Answer | None:
        """Return `read(folder)` for an entry, or None if the entry does not exist.

        If the entry is damaged or `read` raises, log a warning, remove the entry and return None.
        """
        if self.folder is None or not (self.folder / key).is_dir():
            return None
        entry = self.folder / key
        try:
            answer = _read_whole(entry, read)
        except Exception:  # libraries raise different errors for damaged files
            return _read_exclusively(entry, read)
        with suppress(OSError):  # a read-only cache
            os.utime(entry)  # eviction starts with the least recently used entry
        return answer

    def save(self, key: str, write: Callable[[Path], object]) -> None:
        """Save an entry; `write` gets an empty folder. Log a warning if the disk is full or read-only.

        Raises:
            RunError: STEREOGS_CACHE_MB is not a positive integer.
        """
        if self.folder is None:
            return
        entry = self.folder / key
        try:
            with new_folder(entry) as folder:
                write(folder)
                (folder / CHECKSUM).write_text(_checksum(folder), "utf-8")
        except OSError as error:
            if error.errno not in _ANOTHER_WAS_FIRST and not entry.is_dir():
                _log.warning("%s could not be cached: %s", entry, error)
            return
        _make_room(self.folder.parent, entry)


def _read_whole(entry: Path, read: Callable[[Path], Answer]) -> Answer:
    if (entry / CHECKSUM).read_text("utf-8") != _checksum(entry):
        raise ValueError("its checksum differs")
    return read(entry)


def _read_exclusively(entry: Path, read: Callable[[Path], Answer]) -> Answer | None:
    """Move an entry away from other processes and read it again; remove it if it is damaged."""
    aside = entry.with_name(f".{entry.name}.{os.getpid()}-{threading.get_ident()}.partial")
    try:
        entry.rename(aside)
    except FileNotFoundError:  # evicted by another process
        return None
    except OSError as error:
        _log.warning("the cached %s can neither be read nor removed: %s", entry, error)
        return None
    try:
        answer = _read_whole(aside, read)
    except Exception as error:
        _log.warning("the cached %s is damaged (%s); computing it again", entry, error)
        shutil.rmtree(aside, ignore_errors=True)
        return None
    try:
        aside.rename(entry)
    except OSError:  # another process has saved it again
        shutil.rmtree(aside, ignore_errors=True)
    return answer


def _checksum(folder: Path) -> str:
    """Return a hash of the names and contents of an entry's files."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != CHECKSUM:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            digest.update(f"{path.relative_to(folder).as_posix()}\0{content}\0".encode())
    return digest.hexdigest()


def _make_room(root: Path, newest: Path) -> None:
    """Remove the least recently used entries of a cache that is too large, but never the newest."""
    limit = _size_limit()
    with _lock:
        if root in _sizes:
            _sizes[root] += _size(newest)
        else:
            _remove_abandoned(root)
            _sizes[root] = sum(map(_size, _entries(root)))
        if _sizes[root] > limit:
            _sizes[root] = _evict(root, newest, SHARE_KEPT * limit)


def _size_limit() -> int:
    """Return the size limit of the whole cache, bytes."""
    text = os.environ.get(SIZE_VARIABLE, "").strip() or str(DEFAULT_MEGABYTES)
    if not (text.isascii() and text.isdigit() and int(text)):
        raise RunError(
            f"the size of the cache is {text!r}; it must be a positive integer, in megabytes",
            where=f"the environment variable {SIZE_VARIABLE}",
            fix=f"set it to a number such as {DEFAULT_MEGABYTES}; "
            f"an empty {FOLDER_VARIABLE} disables the cache",
        )
    return int(text) * 1_000_000


def _evict(root: Path, newest: Path, wanted: float) -> int:
    """Remove entries, least recently used first; return the remaining bytes."""
    _remove_abandoned(root)
    sizes = {path: _size(path) for path in _entries(root)}
    total = sum(sizes.values())
    for path in sorted(sizes, key=lambda path: (_used(path), path)):
        if total <= wanted:
            break
        if path != newest and _remove(path):
            total -= sizes[path]
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


def _entries(root: Path) -> list[Path]:
    found = (path for path in root.glob("*/*") if _ENTRY.fullmatch(path.name))
    return [path for path in found if (path / CHECKSUM).is_file()]


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
