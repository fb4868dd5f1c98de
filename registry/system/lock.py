"""Exclusive use of a folder by one process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from ..errors import RunError

LOCK = ".lock"
"""The locked file; it holds the number of the process that has the lock."""

if sys.platform == "win32":
    import msvcrt

    _LOCKED_BYTE = (
        1 << 30
    )  # other processes may not read what is locked, and the number is before it

    def _lock(descriptor: int, mode: int = msvcrt.LK_NBLCK) -> None:
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, mode, 1)

    def _unlock(descriptor: int) -> None:
        _lock(descriptor, msvcrt.LK_UNLCK)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _unlock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # a forked child may hold the file open


class Lock(NamedTuple):
    """A lock held by this process.

    Args:
        descriptor: file descriptor; if this process is killed, the lock lasts until all processes that
            inherited it have ended. None on Windows, where none inherits it.
        killed: number of the previous process if it was killed, or None.
    """

    descriptor: int | None
    killed: int | None


@contextmanager
def locked(folder: Path) -> Iterator[Lock]:
    """Hold the lock of an existing folder. The system frees the lock when the process ends.

    Raises:
        RunError: another process has the lock, or the folder cannot be written.
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RunError(
            f"the folder cannot be written: {error.strerror or error}",
            where=str(folder),
            fix="check the permissions, or copy the folder to another place",
        ) from error
    try:
        try:
            _lock(descriptor)
        except OSError as error:
            process = _process(descriptor)
            number = f", number {process}" if process else ""
            raise RunError(
                f"the folder is in use by another process{number}",
                where=str(folder),
                fix="wait until it has ended, or use another folder",
            ) from error
        before = _process(descriptor)
        _note(descriptor, str(os.getpid()))
        try:
            yield Lock(None if sys.platform == "win32" else descriptor, before)
        finally:
            _note(descriptor, "")
            _unlock(descriptor)
    finally:
        os.close(descriptor)


def _process(descriptor: int) -> int | None:
    """Return the number in the lock file; None if its process released the lock."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    text = os.read(descriptor, 20)
    return int(text) if text.isdigit() else None


def _note(descriptor: int, text: str) -> None:
    with suppress(OSError):  # full disk: the lock works without the number
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, text.encode())
