"""Folder and size limit of the cache, from environment variables."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import RunError

FOLDER_VARIABLE = "STEREOGS_CACHE"
"""Environment variable with the cache's folder; empty disables the cache."""
SIZE_VARIABLE = "STEREOGS_CACHE_MB"
"""Environment variable with the size limit in megabytes (1,000,000 bytes)."""
DEFAULT_MEGABYTES = 5000


def cache_root() -> Path | None:
    """Return the folder of the whole cache; None if STEREOGS_CACHE disables caching."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named is None:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return Path(home) / "stereogs"
    return Path(named) if named else None


def cache_folder(kind: str) -> Path | None:
    """Return the folder of one kind of entries; None if STEREOGS_CACHE disables caching."""
    root = cache_root()
    return None if root is None else root / kind


def size_limit() -> int:
    """Return the size limit of the whole cache, bytes.

    Raises:
        RunError: STEREOGS_CACHE_MB is not a positive integer.
    """
    text = os.environ.get(SIZE_VARIABLE, "").strip() or str(DEFAULT_MEGABYTES)
    if not (text.isascii() and text.isdigit() and int(text)):
        raise RunError(
            f"the size of the cache is {text!r}; it must be a positive integer, in megabytes",
            where=f"the environment variable {SIZE_VARIABLE}",
            fix=f"set it to a number such as {DEFAULT_MEGABYTES}; "
            f"an empty {FOLDER_VARIABLE} disables the cache",
        )
    return int(text) * 1_000_000
