"""Run folders on remote file systems: a copy in the cache, which training sends back.

    STEREOGS_CACHE/runs/<key>/fern/                 the run folder
                              .fern.remote.json     its address, and what of it was sent
                              checksum.txt          only if all was sent: the cache may remove it

Files are sent in such an order that the remote folder is a complete run at any time. The remote file
`.writer` names the copy that trains. `resume` on another machine replaces it, and the former copy stops
sending. This is not a lock: while one machine takes over from another, both may write for a moment.
"""

from __future__ import annotations

import json
import logging
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Any
from uuid import uuid4

from ...errors import RunError
from ...system.files import write_json
from ...toolkit.cache.entries import CHECKSUM, Cache
from ...toolkit.cache.keys import content_key
from ...toolkit.cache.remote import RemoteFolder, explained, no_cache
from ...toolkit.progress.parallel import in_parallel

PIPELINE, RESULTS, MANIFEST = "pipeline.yaml", "results.json", "manifest.json"
IS_FILE = "it is a file"
_WRITER, _TEST = ".writer", "a test"
_CHANGED = "the run was removed, or another process has continued it"
_log = logging.getLogger("stereogs")


def opened_copy(url: str) -> Path:
    """Return a copy of a remote run: that of this machine if it has unsent work, or else a new download.

    Raises:
        RunError: no run is there, it cannot be read, or the cache is disabled or full.
    """
    remote = RemoteFolder.at(url)
    try:
        copy = _copy(remote)
    except RunError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        copy = _copy(remote)  # training has removed an old checkpoint meanwhile
    _log.info("%s is read from %s", url, copy)
    return copy


def _copy(remote: RemoteFolder) -> Path:
    files, writer, cache = remote.files(), _writer(remote), _cache(remote.url)
    for record in cache.glob("*/.*.remote.json") if writer else ():
        here = RemoteRun(record)
        if not here.mark.exists() and writer in here.read()["writers"]:
            return here.folder
    if f"{remote.root}/{PIPELINE}" not in files:
        raise _no_run(remote, files, writer)
    entry = cache / remote.key(files)

    def fetch(place: Path) -> None:
        copy = place / remote.name
        remote.download(files, copy)
        record = {"url": remote.url, "writers": [writer], "sent": _states(copy)}
        write_json(_record(copy), record)

    if not entry.is_dir():
        Cache(cache.name).save(entry.name, fetch)
    if not entry.is_dir():
        raise no_cache(remote.url)
    with suppress(OSError):
        os.utime(entry)
    return entry / remote.name


def no_run(reason: str, where: str) -> RunError:
    """Return the error for a path or an address that is not a run folder."""
    fix = "give a folder that `stereogs train` wrote"
    if reason == IS_FILE:
        fix += "; `stereogs view FILE.ply` shows Gaussians"
    return RunError(f"this is not a run folder: {reason}", where=where, fix=fix)


def _no_run(remote: RemoteFolder, files: Mapping[str, str], writer: str | None) -> RunError:
    if writer in (None, "", _TEST):
        reason = "it has no pipeline.yaml" if files else "nothing is stored at this address"
        return no_run(IS_FILE if remote.root in files else reason, remote.url)
    return RunError(
        "this is not a run folder yet: its first files were not all sent",
        where=f"{remote.url}: {str(writer).rpartition(',')[0]}",
        fix=f"`stereogs resume {remote.url}` on that machine sends them; or delete what is stored "
        "there, and train again",
    )


def refuse_stored(url: str) -> None:
    """Refuse an address where something is stored, or that cannot be written."""
    remote = RemoteFolder.at(url)
    _cache(url)
    if remote.files() and _writer(remote) != _TEST:
        fix = f"choose another --out, or continue with `stereogs resume {url}`"
        raise RunError("the folder is not empty", where=url, fix=fix)
    with explained(url, "written"):
        remote.system.pipe_file(f"{remote.root}/{_WRITER}", _TEST.encode())
        remote.system.rm_file(f"{remote.root}/{_WRITER}")


def new_copy(url: str) -> Path:
    """Return the path of a new copy, which is not created yet."""
    refuse_stored(url)
    entry = _cache(url) / content_key(url, uuid4().hex)
    entry.mkdir(parents=True)
    copy = entry / RemoteFolder.at(url).name
    write_json(_record(copy), {"url": url, "writers": [None], "sent": {}})
    return copy


def remote_of(folder: Path) -> RemoteRun | None:
    """Return the remote run of which a folder is a copy; None for a local run."""
    record = _record(folder)
    return RemoteRun(record) if record.is_file() else None


class RemoteRun:
    """A remote run that has a copy here; the record beside the copy is read anew by each method.

    The record has the address as `url`, size and time of each sent file as `sent`, and as `writers` what
    `.writer` may contain if no other copy has written.
    """

    def __init__(self, record: Path) -> None:
        self.record = record
        self.folder = record.with_name(record.name[1:].removesuffix(".remote.json"))
        self.mark = record.with_name(CHECKSUM)

    def read(self) -> dict[str, Any]:
        """Return the record."""
        return dict(json.loads(self.record.read_text("utf-8")))

    @property
    def url(self) -> str:
        """The address."""
        return str(self.read()["url"])

    def take(self) -> None:
        """Become the copy that may send.

        Raises:
            RunError: another copy has written since this one was made, or the remote cannot be written.
        """
        record = self.read()
        remote = RemoteFolder.at(record["url"])
        self._refuse_changed(remote, record)
        own = f"{socket.gethostname()}, process {os.getpid()}, {uuid4().hex}"
        write_json(self.record, {**record, "writers": [*record["writers"], own]})
        self.mark.unlink(missing_ok=True)
        with explained(remote.url, "written", self._fix):
            remote.system.pipe_file(f"{remote.root}/{_WRITER}", own.encode())
        write_json(self.record, {**record, "writers": [own]})

    def send(self, *, last: bool = False) -> None:
        """Send new and changed files, and delete remote files that were deleted here.

        Args:
            last: nothing will change any more, so the cache may remove the copy.

        Raises:
            RunError: another copy has written, or the remote cannot be written; nothing is lost here.
        """
        record = self.read()
        remote, sent = RemoteFolder.at(record["url"]), record["sent"]
        self._refuse_changed(remote, record)
        here = _states(self.folder)
        changed = sorted((name for name in here if sent.get(name) != here[name]), key=_order)
        with explained(remote.url, "written", self._fix):
            for _, names in groupby(changed, key=_order):
                group = [*names]
                in_parallel(lambda name: remote.upload(self.folder / name, name), group)
                sent.update({name: here[name] for name in group})
            for name in [name for name in sent if name not in here]:
                with suppress(FileNotFoundError):
                    remote.system.rm_file(f"{remote.root}/{name}")
                del sent[name]
        write_json(self.record, record)
        if last:
            self.mark.touch()

    def try_to_send(self) -> None:
        """`send`, but only warn if the remote cannot be written; the next call sends it too."""
        try:
            self.send()
        except RunError as error:
            if error.what == _CHANGED:
                raise
            kept = "what was not sent is kept in %s until the next checkpoint or `stereogs resume`"
            _log.warning(f"%s; {kept}", error.what, self.folder)

    @property
    def _fix(self) -> str:
        return f"; all is kept in {self.folder}: `stereogs resume {self.folder}` sends it"

    def _refuse_changed(self, remote: RemoteFolder, record: Mapping[str, Any]) -> None:
        writer = _writer(remote, self._fix)
        if writer not in record["writers"]:
            raise RunError(
                _CHANGED,
                where=f"{remote.url}: {writer.rpartition(',')[0]}" if writer else remote.url,
                fix=f"to keep the copy in {self.folder} as a run of its own, copy it to another place",
            )


def _record(folder: Path) -> Path:
    folder = folder.resolve()  # Path('.').name is empty
    return folder.with_name(f".{folder.name}.remote.json")


def _cache(url: str) -> Path:
    folder = Cache("runs").folder
    if folder is None:
        raise no_cache(url)
    return folder


def _writer(remote: RemoteFolder, fix: str = "") -> str | None:
    """Return the content of `.writer`; None if it is missing."""
    with explained(remote.url, fix=fix):
        try:
            return bytes(remote.system.cat_file(f"{remote.root}/{_WRITER}")).decode()
        except FileNotFoundError:
            return None


def _states(folder: Path) -> dict[str, list[int]]:
    """Return size and time of each file by its name; hidden files are locks or unfinished."""
    states = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            states[name.as_posix()] = [path.stat().st_size, path.stat().st_mtime_ns]
    return states


def _order(name: str) -> tuple[bool, bool, bool]:
    """Sort what makes a run, its results and a checkpoint count behind what they need."""
    return name == PIPELINE, name == RESULTS, PurePosixPath(name).name == MANIFEST
