"""Processes share the runs of a folder: each is trained once, and those of dead processes are taken over."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from core_rasterizer import Device
from registry import RunError
from stereogs import RunOptions
from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import PlannedRun
from stereogs.experiments.running import queue as queues
from stereogs.experiments.running.folder import ExperimentFolder, Peer
from stereogs.experiments.running.queue import STALE_SECONDS, SharedQueue, shared
from tests.host import SELECTION, Plugins, main, start_run
from tests.stereogs.experiments.ablating import plan, write
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that queues see; the test changes it."""
    seconds = [100.0]
    monkeypatch.setattr(queues, "time", SimpleNamespace(monotonic=lambda: seconds[0]))
    return seconds


@pytest.fixture
def runs(toys: Plugins, tmp_path: Path) -> tuple[PlannedRun, ...]:
    return plan(write(tmp_path), toys, toggles="second", seeds=2).runs


class Far:
    """Processes on different machines with one folder."""

    def __init__(self, runs: tuple[PlannedRun, ...], path: Path) -> None:
        self.runs, self.folder, self.held = runs, ExperimentFolder(path), ExitStack()

    def join(self, machine: str) -> SharedQueue:
        peer = Peer("host", machine, "1-a")
        self.held.enter_context(self.folder.locked(peer))
        return self.held.enter_context(shared(self.runs, self.folder, peer))


def taken(queue: SharedQueue) -> list[PlannedRun]:
    """Take all that is free now."""
    found = []
    while (planned := queue.take()) is not None:
        found.append(planned)
    return found


def first_of(queue: SharedQueue) -> PlannedRun:
    planned = queue.take()
    assert planned is not None
    return planned


def finish(folder: ExperimentFolder, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that makes runs count as finished."""
    finished: set[PlannedRun] = set()
    monkeypatch.setattr(folder, "keep", lambda planned: planned in finished)
    return lambda *planned: finished.update(planned)


def test_each_run_is_taken_once(
    runs: tuple[PlannedRun, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: list[float]
) -> None:
    far = Far(runs, tmp_path / "out")
    done = finish(far.folder, monkeypatch)
    with far.held:
        one, two = far.join("one"), far.join("two")
        first = first_of(one)
        assert {first, *taken(two)} == set(runs)
        assert one.take() is None
        assert len(one) == 3
        for planned in runs[1:]:
            two.ended(planned, None)
        done(*runs)
        now[0] += 3
        assert one.take() is None
        assert one.take_settled() == [(planned, "") for planned in runs[1:]]
        assert len(one) == 0
        one.ended(first, None)
    assert list((tmp_path / "out" / "claims").iterdir()) == []
    assert list((tmp_path / "out" / "peers").iterdir()) == []


def test_a_process_on_another_machine_is_dead_when_its_heartbeat_stops(
    runs: tuple[PlannedRun, ...], tmp_path: Path, now: list[float]
) -> None:
    far = Far(runs, tmp_path / "out")
    with far.held:
        one, two = far.join("one"), far.join("two")
        assert taken(one) == [*runs]
        for _ in range(20):  # its heart beats
            now[0] += STALE_SECONDS / 10
            one.lost()
            assert two.take() is None
        now[0] += STALE_SECONDS - 1
        assert two.take() is None
        now[0] += STALE_SECONDS / 10
        assert taken(two) == [*runs]
        # It was only suspended, and learns it; what it writes then is not believed.
        assert one.lost() == [*runs]
        assert not two.lost()
        assert len(one) == 4


def test_a_process_on_this_machine_is_dead_when_its_lock_is_free(
    runs: tuple[PlannedRun, ...], tmp_path: Path, now: list[float]
) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    one, two = Peer("host", "same", "1-a"), Peer("host", "same", "2-a")
    with folder.locked(two), shared(runs, folder, two) as other:
        with folder.locked(one):
            assert taken(SharedQueue(runs, folder, one)) == [*runs]
            assert other.take() is None
        now[0] += 3  # it was killed: its claims and its folder are left
        assert taken(other) == [*runs]


def test_a_run_that_failed_is_tried_again_only_by_a_later_command(
    runs: tuple[PlannedRun, ...], tmp_path: Path, now: list[float]
) -> None:
    far = Far(runs, tmp_path / "out")
    with far.held:
        one, two = far.join("one"), far.join("two")
        first = first_of(one)
        assert one.ended(first, "failed", "no memory")
        assert taken(two) == [*runs[1:]]
        assert two.take_settled() == [(first, "no memory (host_one_1-a)")]
        assert far.join("three").take() == first


def test_data_missing_on_one_machine_is_tried_on_others(
    runs: tuple[PlannedRun, ...], tmp_path: Path, now: list[float]
) -> None:
    """Each toy run names the folder somewhere/garden, which does not exist."""
    far = Far(runs, tmp_path / "out")
    with far.held:
        one, two = far.join("one"), far.join("two")
        first = first_of(one)
        assert not one.ended(first, "not here", "no garden")
        assert one.take() is None  # the others name the same folder, and are not even tried
        assert len(one) == 4
        assert one.take_settled() == []
        assert taken(two) == [*runs]
        for planned in runs:
            assert not two.ended(planned, "not here", "none here either")
        for queue in (one, two):
            now[0] += 3
            assert queue.take() is None
            assert len(queue) == 0
        assert one.take_settled()[0] == (first, "no garden")
        assert two.take_settled() == [(planned, "none here either") for planned in runs]


def test_what_is_stopped_is_free_at_once(
    runs: tuple[PlannedRun, ...], tmp_path: Path, now: list[float]
) -> None:
    far = Far(runs, tmp_path / "out")
    with far.held:
        two = far.join("two")
        one = Far(runs, tmp_path / "out")
        with one.held:
            assert taken(one.join("one")) == [*runs]
        assert taken(two) == [*runs]


def test_a_process_alone_and_processes_that_share_exclude_each_other(
    runs: tuple[PlannedRun, ...], tmp_path: Path
) -> None:
    far = Far(runs, tmp_path / "out")
    with far.held:
        far.join("one")
        with pytest.raises(RunError, match="in use by another process"), far.folder.locked():
            pass
    with far.folder.locked(), pytest.raises(RunError, match="in use by another process"):
        far.join("one")


def test_a_fallback_is_refused(runs: tuple[PlannedRun, ...], toys: Plugins, tmp_path: Path) -> None:
    far = Far(runs, tmp_path / "out")
    with far.held:
        far.join("one")
    prior = replace(runs[0].pipeline.one("scene"), fallback="sgm replaces hitnet")
    items = {**runs[0].pipeline.items, "priors": (prior,)}
    run = replace(runs[0], pipeline=replace(runs[0].pipeline, items=items))
    far = Far((run,), tmp_path / "out")
    with far.held, pytest.raises(RunError, match="no prior may be replaced, but sgm"):
        far.join("one")


SCENE = "{use: procedural, width: 32, height: 24, test_views: 1, points: 100}"
TINY = f"""\
name: tiny
scene: {SCENE}
initializer: sfm
modifiers: [dropout]
metrics: [psnr]
training: {{iterations: 800, sh_degree: 0, checkpoint_every: 50}}
"""


@pytest.mark.proof
def test_a_killed_process_takes_its_training_along_and_another_resumes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr")
    (tmp_path / "tiny.yaml").write_text(TINY)
    out = tmp_path / "out"
    command = ["ablate", str(tmp_path / "tiny.yaml"), "--toggle", "dropout", "--jobs", "1"]
    command += ["--shared", "--out", str(out)]
    process = subprocess.Popen([sys.executable, "-m", "stereogs", *command])
    deadline = time.monotonic() + 120
    while not list(out.glob("runs/*/checkpoint/iteration-00001*/")):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    (log,) = out.glob("runs/*.log")
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "2 runs, 0 finished" in printed
    assert "continuing after iteration" in log.read_text("utf-8")
    assert len(list(out.glob("runs/*/results.json"))) == 2


MATRIX = """\
pipelines: [a.yaml, b.yaml]
scenes: [{use: llff, path: data/garden, downsample: 2}]
iterations: [10, 20]
seeds: 10
"""


@pytest.mark.timeout(1200)
@pytest.mark.skipif(os.environ.get("CLUSTER") != "1", reason="takes minutes: `make cluster`")
def test_forty_runs_on_three_processes_of_which_two_are_killed_and_one_lacks_the_data(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SELECTION, "llff,random,dropout,psnr")
    monkeypatch.chdir(tmp_path)
    write_llff(tmp_path / "data" / "garden", World())
    (tmp_path / "empty").mkdir()
    tiny = TINY.replace(SCENE, "{use: llff, path: data/garden, downsample: 2}")
    tiny = tiny.replace("initializer: sfm", "initializer: {use: random, count: 50}")
    for name, rate in ("a", "0.1"), ("b", "0.2"):
        text = tiny.replace("name: tiny", f"name: {name}")
        (tmp_path / f"{name}.yaml").write_text(
            text.replace("dropout", f"{{use: dropout, rate: {rate}}}")
        )
    (tmp_path / "matrix.yaml").write_text(MATRIX)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "stereogs", "bench", str(tmp_path / "matrix.yaml")]
    command += ["--out", str(out), "--shared", "--jobs", "1"]

    def join(folder: Path) -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)

    def wait_for(results: int) -> None:
        deadline = time.monotonic() + 600
        while len(list(out.glob("runs/*/results.json"))) < results:
            assert time.monotonic() < deadline
            time.sleep(0.1)

    killed, last, without = join(tmp_path), join(tmp_path), join(tmp_path / "empty")
    deadline = time.monotonic() + 120
    says_so = False
    while not says_so:
        assert time.monotonic() < deadline
        time.sleep(0.1)
        for path in out.glob("claims/*/claim.json"):
            with suppress(FileNotFoundError):  # its run was finished meanwhile
                says_so |= "not here" in path.read_text("utf-8")
    assert without.poll() is None  # it waits: the others have the data
    for process, results in (killed, 5), (without, 10):
        wait_for(results)
        process.kill()
        process.wait()
    assert last.wait() == 0
    runs = plan_of(read_matrix(tmp_path / "matrix.yaml"), Plugins()).runs
    assert len(runs) == 40
    options = RunOptions(device=device, progress=False)
    folder = ExperimentFolder(out)
    for run in runs:
        assert folder.results(run)["hash"] == start_run(run.pipeline, options).hash
