"""Entries of the cache: folders that are either complete or absent.

    STEREOGS_CACHE/<kind>/<key>/    the saved files
                     checksum.txt   hash of the files; detects entries damaged by crashes or disk errors

An entry is written to a temporary folder, which is then renamed. If two processes write the same entry, the
first one wins.
"""

from __future__ import annotations

import errno
import hashlib
import inspect
import logging
import os
import shutil
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ...system.files import new_folder
from .eviction import CHECKSUM, make_room
from .place import cache_folder

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

Answer = TypeVar("Answer")
_ANOTHER_WAS_FIRST = (errno.EEXIST, errno.ENOTEMPTY)
_log = logging.getLogger(__name__)


class Cache:
    """All entries of one kind.

    Args:
        kind: Name of the folder, for example the name of the plugin.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind

    @property
    def folder(self) -> Path | None:
        """Folder of the entries; None if STEREOGS_CACHE disables caching."""
        return cache_folder(self.kind)

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
        """Save an entry; log a warning if the disk is full or read-only.

        Args:
            write: Function that writes files into an empty folder.

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
        make_room(self.folder.parent, entry)


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


def content_key(*parts: object) -> str:
    """Return a hash of tensors (type, shape and all bits), bytes, texts, numbers and None, in order.

    Returns:
        32 hexadecimal digits.
    """
    from torch import Tensor

    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            array = part.detach().cpu().contiguous().numpy()
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        elif isinstance(part, bytes):
            digest.update(f"{len(part)} bytes\0".encode())
            digest.update(part)
        else:
            digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()[:32]


def source_digest(*definitions: Callable[..., Any] | ModuleType) -> str:
    """Return a hash of the source files that define classes, functions or modules.

    As part of a key, it invalidates entries when the code that computes them changes.

    Raises:
        TypeError: An argument is not defined in a file.
    """
    files = [inspect.getfile(definition) for definition in definitions]
    return content_key(*(Path(file).read_bytes() for file in files))
