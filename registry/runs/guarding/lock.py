"""One process at a time in a folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from ...errors import RunError

try:
    import fcntl
except ImportError:  # Windows has no such lock; nothing guards against a second process there
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""The file that is locked; it holds the number of the process that works in the folder."""


class Lock(NamedTuple):
    """A folder that is one's own.

    Args:
        descriptor: of an open file: the lock lasts until all processes that inherited it have ended;
            None where there are no such locks.
        taken_over: the process that had the folder before and was killed in it, or None.
    """

    descriptor: int | None
    taken_over: int | None


@contextmanager
def locked(folder: Path) -> Iterator[Lock]:
    """Keep a second process out of a folder, which exists.

    The system frees the lock of a process that ends, however it ends.

    Raises:
        RunError: another one has it, or the folder cannot be written.
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RunError(
            f"nothing can be written there: {error.strerror or error}",
            where=str(folder),
            fix="see who may write there, or copy the folder to where you may",
        ) from error
    try:
        if fcntl is None:
            yield Lock(None, None)
            return
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            process = _process(descriptor)
            raise RunError(
                "the folder is in use by another process"
                + (f", number {process}" if process else ""),
                where=str(folder),
                fix="wait until it has ended, or use another folder",
            ) from error
        before = _process(descriptor)
        _note(descriptor, str(os.getpid()))
        try:
            yield Lock(descriptor, before)
        finally:
            _note(descriptor, "")
    finally:
        os.close(descriptor)


def _process(descriptor: int) -> int | None:
    """The process that the lock's file names; None after one that ended in good order."""
    text = os.pread(descriptor, 20, 0)
    return int(text) if text.isdigit() else None


def _note(descriptor: int, text: str) -> None:
    with suppress(OSError):  # a full disk: the lock holds all the same
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
