"""Data on remote file systems: paths such as s3://bucket/scene, which fsspec reads, copied into the cache.

A copy is complete or absent, and is made again if the names, sizes or ETags of the files have changed.
Credentials come from the environment or the user's own files, as the file system's package documents.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from ...errors import RunError
from ..progress.parallel import in_parallel
from .entries import FOLDER_VARIABLE, Cache
from .keys import content_key

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.+)")
"""At least two characters before the colon: `C:/` is a drive."""
_LOCAL = ("file", "local")
_FULL = (errno.ENOSPC, errno.EDQUOT)
_STATES = ("size", "ETag", "etag", "md5", "mtime", "LastModified", "created")
"""What file systems say about a file that changes with its content."""


def url_of(path: Path | str) -> str | None:
    """Return the URL that a path stands for, whose slashes `Path` has merged; None for a local path."""
    found = _URL.fullmatch(path.as_posix() if isinstance(path, Path) else path)
    if found is None:
        return None
    scheme, rest = found.groups()
    return f"{scheme}:///{rest}" if scheme in _LOCAL else f"{scheme}://{rest}"


def local_copy(path: Path) -> Path:
    """Return a local path itself, and for a URL the path of a local copy of that folder or file.

    Raises:
        RunError: its package is missing, nothing is there, it cannot be read, a name in it leads
            outside, the address contains credentials, or the cache is disabled or full.
    """
    url = url_of(path)
    if url is None:
        return path
    if "@" in PurePosixPath(url.partition("://")[2]).parts[0]:
        what = "the address contains credentials, which would be recorded with the run"
        raise RunError(what, fix="give them in the environment, for example AWS_ACCESS_KEY_ID")
    cache, (system, root, files) = Cache("remote"), _listing(url)
    key = content_key(url, *(f"{name} {state}" for name, state in files.items()))
    name = PurePosixPath(root).name

    def download(folder: Path) -> None:
        base, places = PurePosixPath(root).parent, {}
        for file in files:
            places[file] = folder / PurePosixPath(file).relative_to(base)
            if not places[file].resolve().is_relative_to(folder.resolve() / name):
                raise RunError("a name leads outside of the folder", where=f"{url}: {file}")
            places[file].parent.mkdir(parents=True, exist_ok=True)
        with _explained(url):
            in_parallel(lambda f: system.get_file(f, str(places[f])), list(files), stage="fetching")

    copy = cache.load(key, lambda folder: folder / name)
    if copy is None:
        cache.save(key, download)
        copy = cache.load(key, lambda folder: folder / name)
    if copy is None:
        raise RunError(
            "remote data needs the cache, which is disabled or cannot be written",
            where=url,
            fix=f"set {FOLDER_VARIABLE} to a folder with free space",
        )
    return copy


def _listing(url: str) -> tuple[Any, str, dict[str, str]]:
    """Return a file system, the path of a URL in it, and the state of each file below by its path."""
    with _explained(url):
        from fsspec.core import url_to_fs

        system, root = url_to_fs(url)
        system.invalidate_cache()
        root = root.rstrip("/")
        found = system.find(root, detail=True)
    files = {
        name: " ".join(f"{key}={info[key]}" for key in _STATES if key in info)
        for name, info in sorted(found.items())
        if info.get("type") == "file" and not name.endswith("/")
    }
    if not files:
        raise RunError("nothing is stored at this address", where=url, fix="check the address")
    return system, root, files


@contextmanager
def _explained(url: str) -> Iterator[None]:
    """Explain the errors of a file system; their types depend on its package."""
    try:
        yield
    except ImportError as error:
        raise RunError(
            f"the package of this file system is not installed: {error}",
            where=url,
            fix="for S3: pip install 'stereogs-plugins[remote]'",
        ) from error
    except Exception as error:
        if getattr(error, "errno", None) in _FULL:  # of the cache, which says so
            raise
        raise RunError(
            f"the data cannot be read: {type(error).__name__}: {error}",
            where=url,
            fix="check the address, the network and the credentials, which come from the "
            "environment or, for S3, ~/.aws",
        ) from error
