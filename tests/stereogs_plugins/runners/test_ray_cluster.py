"""`ray`: results land whole and once, whatever happens to workers.

Tests of `stereogs.experiments`, which import its modules.
"""

from __future__ import annotations

import io
import os
import tarfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from core_rasterizer import Device, open_device
from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import Plan as MatrixPlan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.running.pool import Outcome, PoolProgress, choose_runner, train_all
from stereogs_plugins.runners.ray_cluster import extract
from tests.host import SELECTION, Plugins, parse_yaml

SCENE = "{use: procedural, width: 32, height: 24, test_views: 1, points: 100}"
PIPELINE = f"""\
name: NAME
scene: {SCENE}
initializer: sfm
modifiers: [{{use: dropout, rate: RATE}}]
metrics: [psnr]
training: {{iterations: 20, sh_degree: 0}}
"""
MATRIX = f"pipelines: [a.yaml, b.yaml]\nscenes: [{SCENE}]\niterations: [10, 20]\nseeds: 3\n"


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
def workers() -> Iterator[tuple[Any, list[Any]]]:
    """A cluster of this machine: a head that trains nothing, and two workers."""
    if os.environ.get("CLUSTER") != "1":
        pytest.skip("a cluster takes a minute: `make cluster`")
    ray = pytest.importorskip("ray", reason="pip install 'stereogs-plugins[cluster]'")
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=2) for _ in range(2)]
    yield cluster, nodes
    ray.shutdown()
    cluster.shutdown()


def planned(folder: Path, plugins: Plugins) -> MatrixPlan:
    for name, rate in ("a", "0.1"), ("b", "0.2"):
        text = PIPELINE.replace("NAME", name).replace("RATE", rate)
        (folder / f"{name}.yaml").write_text(text)
    (folder / "matrix.yaml").write_text(MATRIX)
    return plan_of(read_matrix(folder / "matrix.yaml"), plugins)


def trained(
    plan: MatrixPlan, folder: ExperimentFolder, runner: str, device: Device, plugins: Plugins
) -> Outcome[Any]:
    written = parse_yaml(runner, "runner", has_lines=False)
    with folder.locked():
        return train_all(
            plan.runs,
            folder,
            choose_runner(written, None, plugins, device),
            device=device.name,
            console=Console(file=io.StringIO()),
        )


def test_a_worker_killed_in_the_middle_costs_no_result(
    workers: tuple[Any, list[Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr,ray")
    plugins, device = Plugins(), open_device()
    plan = planned(tmp_path, plugins)
    assert len(plan.runs) == 12
    here, far = ExperimentFolder(tmp_path / "here"), ExperimentFolder(tmp_path / "far")
    assert trained(plan, here, "{use: local, jobs: 2}", device, plugins).failures == {}

    cluster, nodes = workers
    ended: list[tuple[float, str]] = []
    tell = PoolProgress.ended

    def kill_after_the_third(self: PoolProgress, name: str, failure: str) -> None:
        tell(self, name, failure)
        ended.append((time.monotonic(), failure))
        if len(ended) == 3:
            cluster.remove_node(nodes.pop(), allow_graceful=False)

    monkeypatch.setattr(PoolProgress, "ended", kill_after_the_third)
    runner = f"{{use: ray, address: '{cluster.address}'}}"
    assert trained(plan, far, runner, device, plugins).failures == {}
    assert len(nodes) == 1  # the other was killed
    assert len(ended) == 12
    hashes = [here.results(run)["hash"] for run in plan.runs]
    assert [far.results(run)["hash"] for run in plan.runs] == hashes
    assert len(set(hashes)) == 12
    left = {path.name for path in (tmp_path / "far" / "runs").iterdir() if path.is_dir()}
    assert left == {run.name for run in plan.runs}
