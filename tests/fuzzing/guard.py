"""Detect forbidden actions of readers: start a program, use the network, unpickle, write elsewhere."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_FORBIDDEN = (
    *("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "pty.spawn"),
    *("socket.connect", "socket.getaddrinfo", "pickle.find_class"),
)
_allowed: list[Path] = []
"""The only folder that may be written during `watched`."""


class Forbidden(BaseException):
    """A forbidden action happened; not an `Exception`, so that readers cannot catch it."""


@contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Raise `Forbidden` if the block does more than reading, and writing in `folder`."""
    _install()
    _allowed.append(folder)
    try:
        yield
    finally:
        _allowed.pop()


_installed = False


def _install() -> None:
    """Install the audit hook, which cannot be removed; it is inactive outside `watched`."""
    global _installed
    if not _installed:
        sys.addaudithook(_hook)
        _installed = True


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _allowed:
        return
    if event in _FORBIDDEN:
        raise Forbidden(f"{event} {arguments!r:.200}")
    if event == "open":
        path, mode, flags = arguments
        writes = any(c in (mode or "") for c in "wax+")
        writes = writes or (mode is None and bool(flags & (os.O_WRONLY | os.O_RDWR)))
        if writes and not isinstance(path, int) and not _inside(path):
            raise Forbidden(f"{path!r} is opened for writing")


def _inside(path: Any) -> bool:
    name = os.path.realpath(os.fsdecode(path))
    return name == os.devnull or name.startswith(f"{os.path.realpath(_allowed[-1])}{os.sep}")
