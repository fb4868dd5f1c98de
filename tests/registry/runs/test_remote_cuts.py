"""A machine that dies while it sends a run: after each write, what is stored is a run or is refused."""

from __future__ import annotations

from collections.abc import Iterator
from errno import ENOSPC
from pathlib import Path
from shutil import copytree
from typing import Any, NamedTuple

import fsspec
import pytest
from fsspec.implementations.local import LocalFileSystem
from fsspec.implementations.memory import MemoryFile, MemoryFileSystem

from core_rasterizer import Device
from registry import RunError
from registry.runs.folder import RunFolder
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.outputs import renew
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from tests.host import Plugins
from tests.registry.runs.toy_run import pipeline

URL = "memory://bucket/fern"
ROOT = "/bucket/fern"
WRITER = f"{ROOT}/.writer"
SHORT = ("training.iterations=4", "training.checkpoint_every=2", "training.evaluate_every=0")


class Cut(NamedTuple):
    """What is stored after a write, and the cache of the machine that wrote."""

    stored: dict[str, MemoryFile]
    cache: Path

    @property
    def iteration(self) -> int | None:
        """The newest checkpoint whose manifest is stored; None without the run's pipeline.yaml."""
        if f"{ROOT}/pipeline.yaml" not in self.stored:
            return None
        names = (Path(name) for name in self.stored)
        return max(int(name.parent.name[-7:]) for name in names if name.name == "manifest.json")

    @property
    def taken(self) -> bool:
        """Whether a machine has begun to send the run."""
        return len(self.stored.get(WRITER, MemoryFile()).getvalue()) > len("a test")


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryFileSystem]:
    monkeypatch.setattr("registry.toolkit.progress.parallel.usable_cores", lambda: 1)
    monkeypatch.setattr("registry.runs.origin.code_digest", lambda *_: "")  # for speed
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "first"))
    yield (system := fsspec.filesystem("memory"))
    system.store.clear()


def train(toys: Plugins, device: Device, url: str = URL, *, until: int = 4) -> Run:
    options = RunOptions(device=device, progress=False, callback=lambda done: done.number < until)
    return start_run(pipeline(toys, *SHORT), options, Path(url))


def resume(toys: Plugins, device: Device, url: str = URL) -> Run:
    options = RunOptions(device=device, progress=False)
    return continue_run(RunFolder.existing(Path(url)).path, options, toys)


def is_complete(memory: MemoryFileSystem) -> bool:
    """Return whether a copy that sent the run finished it, and no other file is stored."""
    copy = RunFolder.existing(Path(URL)).path
    files = {path for path in copy.rglob("*") if path.is_file() and not path.name.startswith(".")}
    stored = {path.relative_to(copy).as_posix(): path.read_bytes() for path in files}
    there = {name.removeprefix(f"{ROOT}/"): file.getvalue() for name, file in memory.store.items()}
    return "results.json" in stored and stored == {n: c for n, c in there.items() if n != ".writer"}


def cuts(
    case: str, toys: Plugins, device: Device, tmp_path: Path, memory: MemoryFileSystem
) -> tuple[str, list[Cut]]:
    """Return the hash of the whole run, and each cut of sending it."""
    found: list[Cut] = []
    (tmp_path / "first").mkdir()
    if case != "new":
        train(toys, device, until=3 if case == "continued" else 4)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("put_file", "pipe_file", "rm_file"):
            original = getattr(MemoryFileSystem, name)

            def act(*given: Any, original: Any = original, **named: Any) -> None:
                original(*given, **named)
                place = copytree(tmp_path / "first", tmp_path / f"cut-{len(found)}")
                found.append(Cut(dict(memory.store), place))

            patch.setattr(MemoryFileSystem, name, act)
        whole = train(toys, device) if case == "new" else resume(toys, device)
    return whole.hash, found


@pytest.mark.parametrize("case", ["new", "continued", "again"])
def test_every_cut_is_a_run_or_is_refused(
    case: str,
    memory: MemoryFileSystem,
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, found = cuts(case, toys, device, tmp_path, memory)
    for number, cut in enumerate(found):
        memory.store.clear()
        memory.store.update(cut.stored)
        use = ("eval", "resume", "resume here")[number % 3]
        cache = cut.cache if use == "resume here" else tmp_path / f"other-{number}"
        monkeypatch.setenv("STEREOGS_CACHE", str(cache))
        if cut.iteration is None and not (use == "resume here" and cut.taken):
            reason = "its first files were not all sent" if cut.taken else "not a run folder: "
            with pytest.raises(RunError, match=reason):
                resume(toys, device)
            if cut.taken:
                memory.store.clear()  # the remedy
            assert train(toys, device).hash == whole
            continue
        run = load_run(RunFolder.existing(Path(URL)).path, plugins=toys, device=device)
        assert run.iteration == cut.iteration or use == "resume here"
        if use == "eval":
            results = renew(run, run.folder_or_refuse())
            assert results["iterations"] == cut.iteration
            assert (results["hash"] == whole) == (cut.iteration == 4)
        else:
            assert resume(toys, device).hash == whole
            assert is_complete(memory)


def test_a_write_that_fails_is_made_up_for(
    memory: MemoryFileSystem, toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    writes = list[str]()
    for name in ("put_file", "pipe_file", "rm_file"):
        original = getattr(MemoryFileSystem, name)

        def act(*given: Any, original: Any = original, **named: Any) -> None:
            writes.append(original.__name__)
            if len(writes) == failing:
                raise ConnectionError("no route")
            original(*given, **named)
            if f"{ROOT}/results.json" in memory.store:
                assert memory.exists(f"{ROOT}/checkpoint/iteration-0000004/manifest.json")

        monkeypatch.setattr(MemoryFileSystem, name, act)
    for failing in range(1, 30, 4):
        writes.clear()
        memory.store.clear()
        try:
            train(toys, device)
        except RunError as error:
            copy = error.fix.partition("`stereogs resume ")[2].partition("`")[0]
            assert resume(toys, device, copy).finished if copy else train(toys, device).finished
        assert len(writes) > failing
        assert is_complete(memory)


def test_a_full_disk_keeps_the_files_of_before(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"file://{tmp_path.as_posix()}/far"
    train(toys, device, url, until=3)

    def half(self: LocalFileSystem, here: str, there: str, **_: Any) -> None:
        content = Path(here).read_bytes()
        Path(there).write_bytes(content[: len(content) // 2])
        if here.endswith("provenance.json"):
            raise OSError(ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(LocalFileSystem, "put_file", half)
        with pytest.raises(RunError, match="No space left"):
            resume(toys, device, url)
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "other"))
    assert resume(toys, device, url).finished
    assert not list((tmp_path / "far").rglob("*.partial"))
