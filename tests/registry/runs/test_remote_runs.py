"""Runs on remote file systems: in memory, and on an S3 server of this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copytree
from typing import Any

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from core_rasterizer import Device
from registry import RunError
from registry.runs.folder import RunFolder
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from registry.toolkit.cache import Cache
from tests.host import Plugins
from tests.registry.runs.toy_run import pipeline, resumed, run

OFTEN = "training.checkpoint_every=10"


@pytest.fixture(autouse=True)
def _first_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_machine("first", tmp_path, monkeypatch)


def use_machine(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(folder / name))


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryFileSystem]:
    yield (system := fsspec.filesystem("memory"))
    system.store.clear()


@contextmanager
def unreachable(system: MemoryFileSystem) -> Iterator[None]:
    def fail(*_: object, **__: object) -> None:
        raise ConnectionError("no route")

    names = ("find", "cat_file", "put_file", "pipe_file", "rm_file")
    with pytest.MonkeyPatch.context() as patch:
        for name in names:
            patch.setattr(type(system), name, fail)
        yield


def trained(
    url: str, toys: Plugins, device: Device, *, until: int = 30, first: Any = lambda: None
) -> Run:
    def callback(done: Any) -> bool:
        if done.number == 1:
            first()
        return bool(done.number < until)

    options = RunOptions(device=device, progress=False, callback=callback)
    return start_run(pipeline(toys, OFTEN), options, Path(url))


def copy_of(url: str) -> Path:
    return RunFolder.existing(Path(url)).path


def names(folder: Path) -> set[str]:
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {path.as_posix() for path in found if not path.name.startswith(".")}


def test_a_run_is_continued_on_another_machine(
    remote_root: str, toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"{remote_root}/runs/fern"
    whole, _, _ = run(toys, device, tmp_path / "whole", OFTEN)
    stopped = trained(url, toys, device, until=12)
    assert not stopped.finished
    use_machine("second", tmp_path, monkeypatch)
    copy = copy_of(f"{url}/")
    assert (copy.name, load_run(copy, plugins=toys, device=device).iteration) == ("fern", 12)
    done = resumed(copy, toys, device)
    assert done.folder_or_refuse().shown("results.json") == f"{url}/results.json"
    use_machine("third", tmp_path, monkeypatch)
    read = RunFolder.existing(Path(url))
    assert read.results()["hash"] == whole.results()["hash"]
    at_30 = {f"checkpoint/iteration-00000{n}" for n in (20, 30)}
    assert {Path(n).parent.as_posix() for n in names(read.path) if n.startswith("check")} == at_30
    assert names(read.path) == names(copy)
    with pytest.raises(RunError, match="not empty") as occupied:
        trained(url, toys, device)
    assert f"stereogs resume {url}" in occupied.value.fix
    use_machine("first", tmp_path, monkeypatch)
    with pytest.raises(RunError, match="another process has continued it") as late:
        resumed(stopped.folder_or_refuse().path, toys, device)
    assert "copy it to another place" in late.value.fix
    copytree(stopped.folder_or_refuse().path, tmp_path / "own")
    assert resumed(tmp_path / "own", toys, device).hash == read.results()["hash"]


def test_what_is_stored_is_a_run_after_every_single_write(
    memory: MemoryFileSystem,
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    moments: list[dict[str, Any]] = []

    def recorded(name: str) -> None:
        original = getattr(MemoryFileSystem, name)

        def act(self: MemoryFileSystem, *given: Any, **named: Any) -> None:
            original(self, *given, **named)
            moments.append(dict(memory.store))

        monkeypatch.setattr(MemoryFileSystem, name, act)

    monkeypatch.setattr("registry.toolkit.progress.parallel.usable_cores", lambda: 1)
    for name in ("put_file", "pipe_file", "rm_file"):
        recorded(name)
    trained("memory://bucket/fern", toys, device)
    found = []
    for number, moment in enumerate([*moments]):
        memory.store.clear()
        memory.store.update(moment)
        use_machine(f"machine-{number}", tmp_path, monkeypatch)
        if "/bucket/fern/pipeline.yaml" not in moment:
            with pytest.raises(RunError, match="not a run folder"):
                copy_of("memory://bucket/fern")
        else:
            copy = copy_of("memory://bucket/fern")
            found.append(load_run(copy, plugins=toys, device=device).iteration)
            if found[-1] >= 20:
                assert '"iteration": 20' in (copy / "metrics.jsonl").read_text()
        if "/bucket/fern/results.json" in moment:
            assert moment.keys() >= moments[-1].keys()
    assert found == sorted(found)
    assert {*found} == {0, 10, 20, 30}


def test_work_that_cannot_be_sent_is_kept_here(
    memory: MemoryFileSystem, toys: Plugins, device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    down = unreachable(memory)
    with pytest.raises(RunError, match="cannot be read: ConnectionError: no route") as caught:
        trained("memory://bucket/fern", toys, device, first=down.__enter__)
    down.__exit__(None, None, None)
    assert "kept in" in caplog.text
    copy = Path(caught.value.fix.partition("`stereogs resume ")[2].partition("`")[0])
    assert RunFolder(copy).results()["iterations"] == 30
    assert not memory.exists("/bucket/fern/results.json")
    assert copy_of("memory://bucket/fern") == copy, "it has more than what is stored"
    resumed(copy, toys, device)
    assert memory.exists("/bucket/fern/results.json")


def test_a_failure_before_training_leaves_the_address_usable(
    memory: MemoryFileSystem, toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    with unreachable(memory), pytest.raises(RunError, match="no route"):
        trained("memory://bucket/fern", toys, device)
    monkeypatch.setenv("STEREOGS_CACHE", "")
    with pytest.raises(RunError, match="needs the cache"):
        trained("memory://bucket/fern", toys, device)
    assert not memory.store


def test_the_cache_removes_only_copies_that_were_sent(
    memory: MemoryFileSystem, toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = trained("memory://bucket/sent", toys, device).folder_or_refuse()
    unsent = trained("memory://bucket/unsent", toys, device, until=12).folder_or_refuse().path
    down = unreachable(memory)
    options = RunOptions(device=device, progress=False, on_begin=lambda _: down.__enter__())
    with pytest.raises(RunError, match="no route"):
        continue_run(unsent, options, toys)
    down.__exit__(None, None, None)
    monkeypatch.setenv("STEREOGS_CACHE_MB", "1")
    Cache("big").save("0" * 32, lambda folder: (folder / "x").write_bytes(bytes(2_000_000)))
    assert not sent.path.exists()
    assert (unsent / "results.json").is_file()


def test_a_removed_run_is_not_filled_in_part(
    memory: MemoryFileSystem, toys: Plugins, device: Device
) -> None:
    with pytest.raises(RunError, match="the run was removed"):
        trained("memory://bucket/fern", toys, device, first=memory.store.clear)
    assert not memory.store


def test_a_checkpoint_that_is_replaced_while_it_is_read(
    memory: MemoryFileSystem, toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_ = trained("memory://bucket/fern", toys, device, until=12).folder_or_refuse()
    fetch, tries = MemoryFileSystem.get_file, list[str]()

    def gone_once(self: MemoryFileSystem, file: str, *given: Any, **named: Any) -> None:
        tries.append(file)
        if len(tries) == 1:
            raise FileNotFoundError(file)
        fetch(self, file, *given, **named)

    monkeypatch.setattr(MemoryFileSystem, "get_file", gone_once)
    copy = copy_of("memory://bucket/fern")
    assert names(copy) == names(run_.path)
    assert copy != run_.path
    assert RunFolder(copy).lasting == Path("runs", "fern"), "for what is made by hand"


def test_files_of_a_mounted_disk(toys: Plugins, device: Device, tmp_path: Path) -> None:
    url = f"file://{tmp_path.as_posix()}/far/fern"
    done = trained(url, toys, device)
    assert RunFolder(tmp_path / "far" / "fern").results()["hash"] == done.hash
    assert load_run(copy_of(url), plugins=toys, device=device).finished


def test_a_local_folder_has_no_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert RunFolder(Path()).remote is None
    assert RunFolder(Path("x")).shown("y") == str(Path("x", "y"))
