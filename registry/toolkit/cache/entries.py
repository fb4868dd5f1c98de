"""Entries of the cache: folders that are whole or absent.

    STEREOGS_CACHE/<kind>/<key>/    the files that were saved
                     checksum.txt   a hash over them: what a crash or a bad disk left is never read

An entry is written beside its place and renamed; of two who write one entry, the first wins.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import shutil
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from ...system.files import new_folder
from .eviction import CHECKSUM, make_room
from .place import cache_folder

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Answer = TypeVar("Answer")
_ANOTHER_WAS_FIRST = (errno.EEXIST, errno.ENOTEMPTY)
_log = logging.getLogger(__name__)


class Cache:
    """The entries of one kind.

    Args:
        kind: a plain name, such as that of the plugin; also the name of the folder.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind

    @property
    def folder(self) -> Path | None:
        """Where the entries lie; None where STEREOGS_CACHE switches caching off."""
        return cache_folder(self.kind)

    def load(self, key: str, read: Callable[[Path], Answer]) -> Answer | None:
        """What `read` makes of an entry's folder; None if there is no entry.

        An entry that is damaged, or that `read` raises on, is reported and removed: also None.
        """
        if self.folder is None or not (self.folder / key).is_dir():
            return None
        entry = self.folder / key
        try:
            answer = _read_whole(entry, read)
        except Exception:  # every library has errors of its own for damaged files
            return _read_aside(entry, read)
        with suppress(OSError):  # a cache that may only be read
            os.utime(entry)  # the least recently used entry is the first to go
        return answer

    def save(self, key: str, write: Callable[[Path], object]) -> None:
        """Keep an entry. A full or read-only disk is reported; the caller goes on without.

        Args:
            write: fills an empty folder with files.

        Raises:
            RunError: STEREOGS_CACHE_MB is no positive whole number.
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
        make_room(self.folder.parent, entry)


def _read_whole(entry: Path, read: Callable[[Path], Answer]) -> Answer:
    if (entry / CHECKSUM).read_text("utf-8") != _checksum(entry):
        raise ValueError("its checksum is another")
    return read(entry)


def _read_aside(entry: Path, read: Callable[[Path], Answer]) -> Answer | None:
    """Look a second time, where no other process can make room or save anew meanwhile.

    What is then still damaged is reported and removed.
    """
    aside = entry.with_name(f".{entry.name}.{os.getpid()}-{threading.get_ident()}.partial")
    try:
        entry.rename(aside)
    except FileNotFoundError:  # another process has just made room
        return None
    except OSError as error:
        _log.warning("the cached %s cannot be read and not be removed: %s", entry, error)
        return None
    try:
        answer = _read_whole(aside, read)
    except Exception as error:
        _log.warning("the cached %s is damaged (%s); computing anew", entry, error)
        shutil.rmtree(aside, ignore_errors=True)
        return None
    try:
        aside.rename(entry)
    except OSError:  # another process has saved it again
        shutil.rmtree(aside, ignore_errors=True)
    return answer


def _checksum(folder: Path) -> str:
    """A hash over the names and contents of an entry's files."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != CHECKSUM:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            digest.update(f"{path.relative_to(folder).as_posix()}\0{content}\0".encode())
    return digest.hexdigest()
