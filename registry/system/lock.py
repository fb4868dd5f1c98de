"""Exclusive use of a folder by one process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from ..errors import RunError

try:
    import fcntl
except ImportError:  # Windows has no such lock, and a second process is not refused there
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""The locked file; it holds the number of the process that has the lock."""


class Lock(NamedTuple):
    """A lock held by this process.

    Args:
        descriptor: file descriptor; if this process is killed, the lock lasts until all processes that
            inherited it have ended. None on Windows.
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
        if fcntl is None:
            yield Lock(None, None)
            return
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
            yield Lock(descriptor, before)
        finally:
            _note(descriptor, "")
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # a forked child may hold the file open
    finally:
        os.close(descriptor)


def _process(descriptor: int) -> int | None:
    """Return the number in the lock file; None if its process released the lock."""
    text = os.pread(descriptor, 20, 0)
    return int(text) if text.isdigit() else None


def _note(descriptor: int, text: str) -> None:
    with suppress(OSError):  # full disk: the lock works without the number
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
