"""The cache: complete entries, size limit, concurrent writers."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from registry import RunError
from registry.toolkit.cache import Cache, content_key, entries

KEYS = [content_key(number) for number in range(8)]


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("STEREOGS_CACHE_MB", "1")
    return tmp_path / "cache"


def save(cache: Cache, key: str, kilobytes: int = 1) -> None:
    cache.save(key, lambda folder: (folder / "a").write_bytes(bytes(1000 * kilobytes)))


def load(cache: Cache, key: str) -> bytes | None:
    return cache.load(key, lambda folder: (folder / "a").read_bytes())


def used_at(root: Path, key: str, seconds: int) -> None:
    os.utime(root / "kind" / key, (seconds, seconds))


def test_saved_entries_are_found(root: Path) -> None:
    cache = Cache("kind")
    assert load(cache, KEYS[0]) is None
    save(cache, KEYS[0])
    assert load(Cache("kind"), KEYS[0]) == bytes(1000)
    assert load(Cache("other"), KEYS[0]) is None
    assert load(cache, KEYS[1]) is None


def test_an_empty_variable_disables_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.chdir(tmp_path)
    save(Cache("kind"), KEYS[0])
    assert load(Cache("kind"), KEYS[0]) is None
    assert Cache("kind").folder is None
    assert list(tmp_path.iterdir()) == []


def test_without_the_variable_it_is_in_the_users_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert Cache("sweep").folder == tmp_path / "stereogs" / "sweep"


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "much", "²"])
def test_invalid_sizes_are_explained(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE_MB", text)
    with pytest.raises(RunError, match="must be a positive integer") as error:
        entries._size_limit()
    assert "STEREOGS_CACHE_MB" in error.value.where


def test_the_least_recently_used_entries_are_removed(root: Path) -> None:
    cache = Cache("kind")
    for number in range(4):
        save(cache, KEYS[number], 240)
        used_at(root, KEYS[number], 1000 + number)
    assert load(cache, KEYS[0]) is not None  # used now, so it is no longer the oldest
    save(Cache("other"), KEYS[4], 240)
    assert load(cache, KEYS[1]) is None
    assert load(cache, KEYS[2]) is None  # down to nine tenths
    assert load(cache, KEYS[0]) is not None
    assert load(cache, KEYS[3]) is not None
    assert load(Cache("other"), KEYS[4]) is not None


def test_an_entry_larger_than_the_limit_is_kept(root: Path) -> None:
    cache = Cache("kind")
    save(cache, KEYS[0])
    save(cache, KEYS[1], 2000)
    assert load(cache, KEYS[0]) is None
    assert load(cache, KEYS[1]) is not None


def test_other_files_are_never_removed(root: Path) -> None:
    precious = root / "kind" / "thesis"
    precious.mkdir(parents=True)
    (precious / "text").write_bytes(bytes(3_000_000))
    (root / "kind" / KEYS[7]).mkdir()  # an entry's name, but no checksum
    (root / "kind" / KEYS[7] / "text").write_bytes(bytes(3_000_000))
    for number in range(3):
        save(Cache("kind"), KEYS[number], 900)
    assert (precious / "text").is_file()
    assert (root / "kind" / KEYS[7] / "text").is_file()


def test_an_unfinished_entry_is_never_read(root: Path) -> None:
    cache = Cache("kind")

    def stop(folder: Path) -> None:
        (folder / "a").write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.save(KEYS[0], stop)
    assert load(cache, KEYS[0]) is None
    assert list((root / "kind").iterdir()) == []


@pytest.mark.parametrize("damage", ["cut", "missing", "other", "no checksum"])
def test_a_damaged_entry_is_reported_and_removed(
    damage: str, root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cache = Cache("kind")
    save(cache, KEYS[0])
    entry = root / "kind" / KEYS[0]
    if damage == "cut":
        (entry / "a").write_bytes(bytes(10))
    elif damage == "missing":
        (entry / "a").unlink()
    elif damage == "other":
        (entry / "b").write_bytes(b"more")
    else:
        (entry / "checksum.txt").unlink()
    assert load(cache, KEYS[0]) is None
    assert "damaged" in caplog.text
    assert not entry.exists()


def test_a_read_only_folder_gives_a_warning(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    root.write_text("in the way")
    save(Cache("kind"), KEYS[0])
    assert "could not be cached" in caplog.text


def test_a_read_only_cache_is_read(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(Cache("kind"), KEYS[0])

    def refuse(path: Path) -> None:
        raise PermissionError(path)

    monkeypatch.setattr(os, "utime", refuse)
    assert load(Cache("kind"), KEYS[0]) == bytes(1000)
    assert load(Cache("kind"), KEYS[0]) == bytes(1000)


def test_leftovers_of_killed_processes_are_removed(root: Path) -> None:
    cache = Cache("kind")
    save(cache, KEYS[0])
    left, recent = (root / "kind" / f".{KEYS[k]}.abc.partial" for k in (1, 2))
    left.mkdir()
    recent.mkdir()
    os.utime(left, (1000, 1000))
    save(cache, KEYS[3], 2000)
    assert not left.exists()
    assert recent.exists()


def test_leftovers_are_removed_below_the_limit_too(root: Path) -> None:
    left = root / "kind" / f".{KEYS[1]}.abc.partial"
    left.mkdir(parents=True)
    os.utime(left, (1000, 1000))
    save(Cache("kind"), KEYS[0])
    assert not left.exists()


def test_threads_can_write_the_same_entry(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    barrier = threading.Barrier(8)

    def work() -> None:
        barrier.wait()
        save(Cache("kind"), KEYS[0], 50)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert load(Cache("kind"), KEYS[0]) == bytes(50_000)
    assert [path.name for path in (root / "kind").iterdir()] == [KEYS[0]]
    assert caplog.text == ""


def test_concurrent_processes_leave_complete_entries(root: Path) -> None:
    code = f"""
from registry.toolkit.cache import Cache
for turn in range(40):
    key = {KEYS!r}[turn % 8]
    Cache("kind").save(key, lambda f: [(f / n).write_bytes(key.encode() * 4000) for n in "ab"])
    found = Cache("kind").load(key, lambda f: ((f / "a").read_bytes(), (f / "b").read_bytes()))
    assert found in (None, (key.encode() * 4000,) * 2)
"""
    running = [
        subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in running:
        assert process.communicate()[1] == ""
        assert process.returncode == 0
    entries._make_room(root, root / "kind" / KEYS[0])
    names = {path.name for path in (root / "kind").iterdir()}
    assert names <= set(KEYS)
    assert all(load(Cache("kind"), name) is not None for name in names)
