"""Data on remote file systems: paths such as s3://bucket/scene, which fsspec reads, copied into the cache.

A copy is complete or absent, and is made again if the names, sizes or ETags of the files have changed.
Credentials come from the environment or the user's own files, as the file system's package documents.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ...errors import RunError
from ...system.files import replacing
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


def on_this_machine(path: Path | str) -> Path:
    """Return a local path; refuse an address, which would become a folder `s3:` here."""
    if url := url_of(path):
        raise RunError(
            "this must be a path on this machine, not an address",
            where=url,
            fix="copy from or to the address with the tools of its file system",
        )
    return Path(path)


def local_copy(path: Path) -> Path:
    """Return a local path itself, and for a URL the path of a local copy of that folder or file.

    Raises:
        RunError: its package is missing, nothing is there, it cannot be read, a name in it leads
            outside, the address contains credentials, or the cache is disabled or full.
    """
    url = url_of(path)
    if url is None:
        return path
    cache, remote = Cache("remote"), RemoteFolder.at(url)
    files = remote.files()
    if not files:
        raise RunError("nothing is stored at this address", where=url, fix="check the address")
    key = remote.key(files)
    copy = cache.load(key, lambda folder: folder / remote.name)
    if copy is None:
        cache.save(key, lambda folder: remote.download(files, folder / remote.name))
        copy = cache.load(key, lambda folder: folder / remote.name)
    if copy is None:
        raise no_cache(url)
    return copy


def no_cache(url: str) -> RunError:
    """Return the error for a cache that is disabled or cannot be written."""
    return RunError(
        "remote data needs the cache, which is disabled or cannot be written",
        where=url,
        fix=f"set {FOLDER_VARIABLE} to a folder with free space",
    )


@dataclass(frozen=True)
class RemoteFolder:
    """A folder or file on a file system of fsspec, which need not exist.

    Args:
        url: its address.
        system: the file system.
        root: its path there, without a slash at the end.
    """

    url: str
    system: Any
    root: str

    @classmethod
    def at(cls, url: str) -> RemoteFolder:
        """Return the folder at an address.

        Raises:
            RunError: the file system's package is missing, or the address contains credentials.
        """
        if "@" in PurePosixPath(url.partition("://")[2]).parts[0]:
            what = "the address contains credentials, which would be recorded with the run"
            raise RunError(what, fix="give them in the environment, for example AWS_ACCESS_KEY_ID")
        with explained(url):
            from fsspec.core import url_to_fs

            local = url.partition(":")[0] in _LOCAL
            system, root = url_to_fs(url, **({"auto_mkdir": True} if local else {}))
        return cls(url, system, root.rstrip("/"))

    @property
    def name(self) -> str:
        """Its last part."""
        return PurePosixPath(self.root).name

    def files(self) -> dict[str, str]:
        """Return the state of each file below by its path in the file system; empty if there is none."""
        with explained(self.url):
            self.system.invalidate_cache()
            found = self.system.find(self.root, detail=True)
        return {
            name: " ".join(f"{key}={info[key]}" for key in _STATES if key in info)
            for name, info in sorted(found.items())
            if info.get("type") == "file" and not name.endswith("/")
        }

    def key(self, files: Mapping[str, str]) -> str:
        """Return the key of a copy of these files."""
        return content_key(self.url, *(f"{name} {state}" for name, state in files.items()))

    def download(self, files: Iterable[str], copy: Path) -> None:
        """Copy these files of the folder, or the file itself, to a path."""
        places = {}
        for file in files:
            places[file] = copy / PurePosixPath(file).relative_to(self.root)
            if not places[file].resolve().is_relative_to(copy.resolve()):
                where = f"{self.url}: {file}"
                raise RunError("a name leads outside of the folder", where=where)
            places[file].parent.mkdir(parents=True, exist_ok=True)
        with explained(self.url):
            in_parallel(
                lambda f: self.system.get_file(f, str(places[f])), list(places), stage="fetching"
            )

    def upload(self, file: Path, name: str) -> None:
        """Replace a file of the folder at once: object stores do that, a disk needs a rename."""
        place = f"{self.root}/{name}"
        if self.url.partition(":")[0] not in _LOCAL:
            self.system.put_file(str(file), place)
            return
        with replacing(Path(place)) as temporary:
            self.system.put_file(str(file), str(temporary))


@contextmanager
def explained(url: str, done: str = "read", fix: str = "") -> Iterator[None]:
    """Explain the errors of a file system; their types depend on its package.

    Args:
        done: what fails, "read" or "written".
        fix: what to do after the cause is removed.
    """
    try:
        yield
    except ImportError as error:
        raise RunError(
            f"the package of this file system is not installed: {error}",
            where=url,
            fix="for S3: pip install 'stereogs-plugins[remote]'",
        ) from error
    except RunError:
        raise
    except Exception as error:
        if done == "read" and getattr(error, "errno", None) in _FULL:  # of the cache, which says so
            raise
        raise RunError(
            f"the data cannot be {done}: {type(error).__name__}: {error}",
            where=url,
            fix="check the address, the network and the credentials, which come from the "
            f"environment or, for S3, ~/.aws{fix}",
        ) from error
