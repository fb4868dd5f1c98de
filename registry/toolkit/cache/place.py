"""Where the cache lies and how large it may grow: two environment variables."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import RunError

FOLDER_VARIABLE = "STEREOGS_CACHE"
"""Environment variable: the cache's folder; empty switches the cache off."""
SIZE_VARIABLE = "STEREOGS_CACHE_MB"
"""Environment variable: the megabytes (1,000,000 bytes) that the cache may hold."""
DEFAULT_MEGABYTES = 5000


def cache_root() -> Path | None:
    """The folder of the whole cache; None where STEREOGS_CACHE switches caching off."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named is None:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return Path(home) / "stereogs"
    return Path(named) if named else None


def cache_folder(kind: str) -> Path | None:
    """The folder of one kind of entries; None where STEREOGS_CACHE switches caching off."""
    root = cache_root()
    return None if root is None else root / kind


def size_limit() -> int:
    """How many bytes the whole cache may hold.

    Raises:
        RunError: STEREOGS_CACHE_MB is set to something that is no positive whole number.
    """
    said = os.environ.get(SIZE_VARIABLE, "").strip() or str(DEFAULT_MEGABYTES)
    if not (said.isascii() and said.isdigit() and int(said)):
        raise RunError(
            f"the size of the cache is {said!r}, which is no positive whole number of megabytes",
            where=f"the environment variable {SIZE_VARIABLE}",
            fix=f"set it to a number such as {DEFAULT_MEGABYTES}; "
            f"an empty {FOLDER_VARIABLE} switches the cache off",
        )
    return int(said) * 1_000_000
