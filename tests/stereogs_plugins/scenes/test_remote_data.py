"""Scenes and runs on a remote file system train and open as if they were here; files name addresses only."""

from __future__ import annotations

from pathlib import Path

import fsspec
import pytest

import stereogs
from tests.host import main
from tests.stereogs_plugins.scenes.small_scenes import World, write_nerfstudio

URL = "memory://bucket/world"
PIPELINE = """\
name: far
scene: {use: nerfstudio, path: URL}
initializer: {use: random, count: 200}
metrics: [psnr]
training: {iterations: 4, sh_degree: 0}
"""


@pytest.fixture(autouse=True)
def _remote_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    write_nerfstudio(Path("here/world"), World())
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    memory.put("here/world/", "/bucket/world", recursive=True)
    Path("far.yaml").write_text(PIPELINE.replace("URL", URL))
    Path("near.yaml").write_text(PIPELINE.replace("URL", "here/world"))


def test_it_trains_to_the_same_bits_and_is_recorded_by_its_address() -> None:
    assert main(["train", "far.yaml", "--out", "far"]) == 0
    assert main(["train", "near.yaml", "--out", "near"]) == 0
    far, near = stereogs.open_run("far"), stereogs.open_run("near")
    assert far.hash == near.hash
    assert far.scene.name == near.scene.name == "world"
    written = Path("far/pipeline.yaml").read_text("utf-8")
    assert f"path: {URL}\n" in written
    files = [path for path in Path("far").rglob("*.json") if path.is_file()]
    assert not any(str(Path("cache").absolute()) in file.read_text("utf-8") for file in files)
    assert main(["eval", "far"]) == 0
    assert main(["resume", "near", "--scene", URL]) == 0


def test_a_run_is_written_to_an_address_and_read_from_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = "memory://bucket/runs/far"
    assert main(["train", "far.yaml", "--out", run]) == 0
    shown = capsys.readouterr().out
    assert f"writing {run}\n" in shown
    assert f"pictures  {run}/renders" in shown
    assert main(["resume", run]) == 0
    for verb in ("render", "eval"):
        assert main([verb, run]) == 0
    assert main(["export", run, "--format", "ply", "--out", "ply"]) == 0
    assert main(["compare", run, run]) == 0
    assert stereogs.results(run)["hash"] == stereogs.open_run(run).hash
    fsspec.filesystem("memory").rm("/bucket/runs/far/results.json")
    assert main(["report", run]) == 2
    assert f"stereogs resume {run}\n" in capsys.readouterr().err


def test_a_pipeline_is_read_from_an_address(capsys: pytest.CaptureFixture[str]) -> None:
    fsspec.filesystem("memory").put_file("far.yaml", "/bucket/far.yaml")
    assert main(["explain", "memory://bucket/far.yaml"]) == 0
    assert "far: 4 iterations" in capsys.readouterr().out
    assert main(["render", "memory://bucket/far.yaml"]) == 2
    assert "not a run folder: it is a file" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["export", "run", "--format", "ply", "--out", f"{URL}/out"],
        ["init", f"{URL}/mine"],
        ["data", "build", "llff-3", "here", "--out", f"{URL}/out"],
        ["data", "check", "llff-3", URL],
        ["new-plugin", "mine", "--kind", "metric", "--into", URL],
        ["models", "get", "itermvs", "--from", f"{URL}/x.onnx"],
        ["next", "run", "--poses", f"{URL}/poses.json"],
        ["priors", "check", f"{URL}/x.onnx"],
        ["view", f"{URL}/scene.ply"],
    ],
)
def test_other_paths_are_of_this_machine(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if command[0] == "view":
        pytest.importorskip("viser")
    assert main(command) == 2
    assert "this must be a path on this machine, not an address" in capsys.readouterr().err
    assert not Path("memory:").exists()


def test_the_verbs_take_an_address(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", URL]) == 0
    assert main(["train", "far.yaml", "--scene", URL, "--out", "named"]) == 0
    small = ["--set", "training.iterations=2", "--set", "initializer={use: random, count: 50}"]
    assert main(["train", URL, "--out", "given", *small]) == 0
    for run in ("named", "given"):
        assert stereogs.results(run)["scene"]["name"] == "world"
        assert URL in Path(run, "pipeline.yaml").read_text("utf-8")
    for command in (
        ["train", "far.yaml", "--out", URL],
        ["ablate", "far.yaml", "--toggle", "psnr", "--out", f"{URL}2"],
        ["render", URL],
        ["compare", URL],
    ):
        assert main(command) == 2
    assert not Path("memory:").exists()
    printed = capsys.readouterr()
    assert f"stereogs train {URL}" in printed.out
    for reason in ("the folder is not empty", "experiment is local", "it has no pipeline.yaml"):
        assert reason in printed.err
