"""Files and folders that are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry.system.files import new_folder, replacing
from registry.toolkit import write_text


def test_a_file_is_replaced_completely_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_on_the_disk_before_it_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named: list[bool] = []
    monkeypatch.setattr("os.fsync", lambda descriptor: named.append((tmp_path / "a").exists()))
    write_text(tmp_path / "a", "text")
    assert named == [False]


def test_a_folder_that_cannot_be_filled_is_removed(tmp_path: Path) -> None:
    def fail() -> None:
        with new_folder(tmp_path / "x") as folder:
            (folder / "file").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("locked", [3, 1000])
def test_a_file_that_another_program_reads_is_replaced_later_on_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locked: int
) -> None:
    replace, path, times = Path.replace, tmp_path / "a", iter(range(locked))

    def as_on_windows(source: Path, target: Path) -> Path:
        if next(times, None) is not None:
            raise PermissionError(13, "The process cannot access the file", target)
        return replace(source, target)

    write_text(path, "old")
    monkeypatch.setattr(Path, "replace", as_on_windows)
    monkeypatch.setattr("sys.platform", "win32")
    if locked > 100:
        with pytest.raises(PermissionError):
            write_text(path, "new")
        assert path.read_bytes() == b"old"
    else:
        write_text(path, "new\n")
        assert path.read_bytes() == b"new\n"
    assert list(tmp_path.iterdir()) == [path]


def test_an_empty_folder_gives_way_on_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename, final = Path.rename, tmp_path / "x"

    def as_on_windows(path: Path, target: Path) -> Path:
        if target.exists():
            raise FileExistsError(target)
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", as_on_windows)
    monkeypatch.setattr("sys.platform", "win32")
    final.mkdir()
    with new_folder(final) as folder:
        (folder / "file").touch()
    assert [path.name for path in final.iterdir()] == ["file"]
