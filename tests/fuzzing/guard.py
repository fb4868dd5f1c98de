"""What reading a file must never do: start a program, ask the network, unpickle, write elsewhere."""

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
"""The one folder that may be written, while something is watched."""


class Forbidden(BaseException):
    """Something happened that no file may make happen; no `except Exception` can hide it."""


@contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Raise `Forbidden` for what the block does beyond reading and writing in `folder`."""
    _install()
    _allowed.append(folder)
    try:
        yield
    finally:
        _allowed.pop()


_installed = False


def _install() -> None:
    """Hooks stay for the life of a process; this one looks away while nothing is watched."""
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
