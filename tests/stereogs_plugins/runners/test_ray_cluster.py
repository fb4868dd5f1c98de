"""`ray`: results land whole and once, whatever happens to workers.

Tests of `stereogs.experiments`, which import its modules.
"""

from __future__ import annotations

import io
import os
import signal
import tarfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from core_rasterizer import Device, open_device
from stereogs import RunOptions
from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import Plan as MatrixPlan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.running.pool import Outcome, PoolProgress, choose_runner, train_all
from stereogs_plugins.runners import ray_cluster
from stereogs_plugins.runners.ray_cluster import extract
from tests.host import SELECTION, Plugins, parse_yaml, start_run
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff

SCENE = "{use: llff, path: data/garden, downsample: 2}"
PIPELINE = f"""\
name: NAME
scene: {SCENE}
initializer: {{use: random, count: 50}}
modifiers: [{{use: dropout, rate: RATE}}]
metrics: [psnr]
training: {{iterations: 20, sh_degree: 0, checkpoint_every: 50}}
"""


def packed(files: dict[str, bytes]) -> bytes:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as file:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            file.addfile(member, io.BytesIO(content))
    return archive.getvalue()


def test_a_result_takes_the_place_of_what_lay_there(tmp_path: Path) -> None:
    folder = tmp_path / "one"
    folder.mkdir()
    (folder / "left over").write_text("from a run that was lost")
    extract(packed({"run/results.json": b"{}"}), folder)
    assert [path.name for path in folder.iterdir()] == ["results.json"]
    assert [path.name for path in tmp_path.iterdir()] == ["one"]


@pytest.mark.parametrize("archive", [b"cut off", packed({"../elsewhere": b"x"}), packed({})])
def test_what_is_no_result_changes_nothing(tmp_path: Path, archive: bytes) -> None:
    folder = tmp_path / "inside" / "one"
    folder.mkdir(parents=True)
    (folder / "results.json").write_text("{}")
    with pytest.raises((tarfile.TarError, OSError)):
        extract(archive, folder)
    assert (folder / "results.json").read_text() == "{}"
    assert [path.name for path in folder.parent.iterdir()] == ["one"]
    assert [path.name for path in tmp_path.iterdir()] == ["inside"]


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A cluster of this machine: a head that trains nothing; tests add workers."""
    if os.environ.get("CLUSTER") != "1":
        pytest.skip("a cluster takes minutes: `make cluster`")
    ray = pytest.importorskip("ray", reason="pip install 'stereogs-plugins[cluster]'")
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    monkeypatch.setenv(SELECTION, "llff,random,dropout,psnr,ray")
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def planned(
    folder: Path, plugins: Plugins, iterations: str = "10, 20", seeds: int = 3
) -> MatrixPlan:
    """Plan 2 pipelines x iterations x seeds, of the scene data/garden in the working folder."""
    write_llff(folder / "data" / "garden", World())
    for name, rate in ("a", "0.1"), ("b", "0.2"):
        text = PIPELINE.replace("NAME", name).replace("RATE", rate)
        (folder / f"{name}.yaml").write_text(text)
    matrix = f"pipelines: [a.yaml, b.yaml]\nscenes: [{SCENE}]\n"
    matrix += f"iterations: [{iterations}]\nseeds: {seeds}\n"
    (folder / "matrix.yaml").write_text(matrix)
    return plan_of(read_matrix(folder / "matrix.yaml"), plugins)


def trained(
    plan: MatrixPlan, folder: ExperimentFolder, runner: str, device: Device, plugins: Plugins
) -> Outcome[Any]:
    written = parse_yaml(runner, "runner", has_lines=False)
    with folder.locked():
        return train_all(
            [run for run in plan.runs if not folder.results(run)],
            folder,
            choose_runner(written, None, plugins, device),
            device=device.name,
            console=Console(file=io.StringIO()),
        )


def hashes_of(plan: MatrixPlan, device: Device) -> list[str]:
    """Train in this process; return the hash of each run."""
    options = RunOptions(device=device, progress=False)
    return [start_run(run.pipeline, options).hash for run in plan.runs]


def test_lost_workers_and_missing_data_cost_no_result(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three workers one does not have the data, and one is killed."""
    plugins, device = Plugins(), open_device()
    monkeypatch.chdir(tmp_path)
    plan = planned(tmp_path, plugins)
    assert len(plan.runs) == 12
    nodes = [cluster.add_node(num_cpus=2) for _ in range(2)]
    (tmp_path / "empty").mkdir()
    with monkeypatch.context() as there:
        there.chdir(tmp_path / "empty")  # where paths of the scene lead nowhere
        cluster.add_node(num_cpus=2)
    ended: list[str] = []
    tell = PoolProgress.ended

    def kill_after_the_third(self: PoolProgress, name: str, failure: str) -> None:
        tell(self, name, failure)
        ended.append(name)
        if len(ended) == 3:
            cluster.remove_node(nodes.pop(), allow_graceful=False)

    monkeypatch.setattr(PoolProgress, "ended", kill_after_the_third)
    far = ExperimentFolder(tmp_path / "far")
    runner = f"{{use: ray, address: '{cluster.address}', memory_mb: 200}}"
    assert trained(plan, far, runner, device, plugins).failures == {}
    assert len(ended) == 12
    assert [far.results(run)["hash"] for run in plan.runs] == hashes_of(plan, device)
    left = {path.name for path in (tmp_path / "far" / "runs").iterdir() if path.is_dir()}
    assert left == {run.name for run in plan.runs}


@pytest.mark.parametrize("is_shared", [True, False])
def test_ctrl_c_and_a_lost_worker_leave_checkpoints(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_shared: bool
) -> None:
    """A training is stopped by Ctrl-C, goes on, loses its worker, and goes on."""
    plugins, device = Plugins(), open_device()
    monkeypatch.chdir(tmp_path)
    (plan_run, *_) = (plan := planned(tmp_path, plugins, "3000", 1)).runs
    plan = replace(plan, runs=(plan_run,))
    nodes = [cluster.add_node(num_cpus=2)]
    if not is_shared:
        submit = ray_cluster.RayCluster.submit

        def elsewhere(self: Any, job: ray_cluster.Job, without: set[str]) -> Any:
            nowhere = tmp_path / "another machine" / "run"
            return submit(self, job._replace(pipeline=nowhere, run=nowhere, log=nowhere), without)

        monkeypatch.setattr(ray_cluster.RayCluster, "submit", elsewhere)
    far = ExperimentFolder(tmp_path / "far")
    runner = f"{{use: ray, address: '{cluster.address}', memory_mb: 200}}"
    pressed: list[float] = []
    shares: list[float] = []

    def press(self: PoolProgress, parts: list[float]) -> None:
        shares.extend(parts)
        if max(parts, default=0.0) > 0.05 and not pressed:
            pressed.append(time.monotonic())
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(PoolProgress, "show", press)
        outcome = trained(plan, far, runner, device, plugins)
    assert outcome.stopped
    assert time.monotonic() - pressed[0] < 10
    run = far.run(plan_run).path
    assert list(run.glob("checkpoint/*/manifest.json"))
    assert far.results(plan_run) == {}

    def lose(self: PoolProgress, parts: list[float]) -> None:
        if max(parts, default=0.0) > 0.3 and nodes:
            cluster.remove_node(nodes.pop(), allow_graceful=False)
            cluster.add_node(num_cpus=2)

    monkeypatch.setattr(PoolProgress, "show", lose)
    assert trained(plan, far, runner, device, plugins).failures == {}
    assert nodes == []
    log = run.with_name(f"{run.name}.log").read_text("utf-8")
    assert "continuing after iteration" in log
    assert [far.results(plan_run)["hash"]] == hashes_of(plan, device)
