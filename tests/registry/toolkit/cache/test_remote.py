"""Local copies of remote folders, on fsspec's file system in memory and on an S3 server of this machine."""

from __future__ import annotations

import errno
import sys
from pathlib import Path, PureWindowsPath
from typing import Any

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFile

from registry import RunError
from registry.toolkit.cache.remote import local_copy, url_of


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def write(url: str, content: bytes) -> None:
    with fsspec.open(url, "wb") as file:
        file.write(content)


def files(folder: Path) -> dict[str, bytes]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_only_urls_are_remote() -> None:
    for text in ("s3://bucket/a/b", "memory://a", "gs://b/c d", "file:///srv/data"):
        assert url_of(text) == url_of(Path(text)) == text
    local = ("C:/data", "C:\\data", "c://data", "data", "/srv/a:/b", "s3:", "s3")
    for text in local:
        assert url_of(text) is None
        assert url_of(Path(text)) is None
    windows: Any = PureWindowsPath("C:\\data")
    assert url_of(windows.as_posix()) is None
    assert local_copy(Path("C:/data")) == Path("C:/data")


def test_a_folder_is_copied_once_and_again_after_a_change(remote_root: str) -> None:
    write(f"{remote_root}/scene/images/1.png", b"one")
    write(f"{remote_root}/scene/poses.npy", b"poses")
    write(f"{remote_root}/scene-2/poses.npy", b"of another scene")
    url = Path(f"{remote_root}/scene")
    copy = local_copy(url)
    assert copy.name == "scene"
    assert files(copy) == {"images/1.png": b"one", "poses.npy": b"poses"}
    began = copy.stat().st_ctime_ns
    assert local_copy(url) == copy
    assert copy.stat().st_ctime_ns == began
    write(f"{remote_root}/scene/poses.npy", b"other")
    assert files(local_copy(url)) == {"images/1.png": b"one", "poses.npy": b"other"}
    assert files(copy)["poses.npy"] == b"poses", "a run that uses it is not disturbed"
    one = local_copy(Path(f"{remote_root}/scene/images/1.png"))
    assert (one.name, one.read_bytes()) == ("1.png", b"one")
    with pytest.raises(RunError, match="nothing is stored"):
        local_copy(Path(f"{remote_root}/nothing"))


def test_a_name_that_leads_outside_is_refused(cache: Path) -> None:
    system = fsspec.filesystem("memory")
    system.store["/bad/../../out.txt"] = MemoryFile(system, "/bad/../../out.txt", b"x")
    try:
        with pytest.raises(RunError, match="outside"):
            local_copy(Path("memory://bad"))
    finally:
        del system.store["/bad/../../out.txt"]
    assert not list(cache.rglob("out.txt"))


def test_a_full_disk_is_not_taken_for_a_fault_of_the_network(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    write("memory://lonely/a", b"a")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "get_file", full)
    with pytest.raises(RunError, match="needs the cache") as caught:
        local_copy(Path("memory://lonely"))
    assert "free space" in caught.value.fix
    assert "No space left" in caplog.text


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    write("memory://lonely/a", b"a")
    monkeypatch.setenv("STEREOGS_CACHE", "")
    with pytest.raises(RunError, match="needs the cache"):
        local_copy(Path("memory://lonely"))
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(RunError) as caught:
        local_copy(Path("gs://bucket/scene"))
    assert "pip install 'stereogs-plugins[remote]'" in caught.value.fix
    with pytest.raises(RunError, match="cannot be read"):
        local_copy(Path("nosuchscheme://a/b"))
    with pytest.raises(RunError, match="credentials"):
        local_copy(Path("s3://id:key@bucket/scene"))
