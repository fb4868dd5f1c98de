from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from registry import RunError
from registry.runs.folder import RunFolder, in_runs
from registry.runs.progress import MetricsLog
from stereogs import Iteration


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_run_folder_has_its_files_or_does_not_exist(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "deep" / "run")

    def fill(folder: RunFolder) -> None:
        assert not run.path.exists()
        (folder.path / "first").touch()

    run.create("name: x\n", {"seed": 1, "run": "ab"}, {"the points": "ab"}, fill)
    assert names(run.path) == ["first", "inputs.json", "pipeline.yaml", "provenance.json"]
    assert run.identity == "ab"
    assert run.inputs() == ({"the points": "ab"}, [])
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["run"]
    other = RunFolder(tmp_path / "other")
    with pytest.raises(ValueError, match="unknown type"):
        other.create("name: x\n", {"seed": object()}, {}, fill)
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]


def test_an_empty_folder_is_taken_and_a_full_one_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    RunFolder(empty).create("name: x\n", {}, {}, lambda folder: None)
    with pytest.raises(RunError, match="not empty") as caught:
        RunFolder(empty).create("name: x\n", {}, {}, lambda folder: None)
    assert "stereogs resume" in caught.value.fix


def test_paths_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(RunError, match="the path is a file"):
        RunFolder.check_vacant(file)
    with pytest.raises(RunError, match="cannot be written"):
        RunFolder.check_vacant(file / "below")
    RunFolder.check_vacant(tmp_path / "a" / "b")
    assert not (tmp_path / "a").exists()


def test_a_folder_without_a_pipeline_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="not a run folder"):
        RunFolder.existing(tmp_path)


def test_default_folders_are_numbered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def chosen(pipeline: str, scene: str) -> Path:
        named: Any = (SimpleNamespace(name=name) for name in (pipeline, scene))
        return in_runs(*named)

    monkeypatch.chdir(tmp_path)
    for name in ("a-b", "a-b-2"):
        Path("runs", name).mkdir(parents=True)
    assert chosen("a", "b") == Path("runs/a-b-3")
    assert chosen("c d", "e") == Path("runs/c-d-e")
    assert chosen("../ü/..", "../ü").parent == Path("runs")
    assert chosen("///", "///") == Path("runs/run")


def ended_process() -> int:
    """Return the id of a process that has ended."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_partial_files_of_killed_processes_are_removed(tmp_path: Path) -> None:
    dead = ended_process()
    leftovers = [tmp_path / f".a.png.{dead}.partial", tmp_path / "deep" / f".b.x1.{dead}.partial"]
    kept = [tmp_path / f".a.png.{os.getpid()}.partial", tmp_path / ".mine", tmp_path / "a.partial"]
    leftovers[1].mkdir(parents=True)
    (leftovers[1] / "half").touch()
    for file in (leftovers[0], *kept):
        file.touch()
    with RunFolder(tmp_path).locked():
        assert not any(path.exists() for path in leftovers)
        assert all(path.exists() for path in kept)


def test_creating_a_run_again_removes_partial_folders(tmp_path: Path) -> None:
    (tmp_path / f".run.x1.{ended_process()}.partial").mkdir()
    RunFolder(tmp_path / "run").create("name: x\n", {}, {}, lambda folder: None)
    assert names(tmp_path) == ["run"]


def test_the_error_for_a_full_disk_says_how_to_continue(tmp_path: Path) -> None:
    (tmp_path / "metrics.jsonl").symlink_to("/dev/full")
    with pytest.raises(RunError, match="No space left") as caught:
        RunFolder(tmp_path).append_metrics({"iteration": 1})
    assert "stereogs resume" in caught.value.fix


def test_a_full_disk_at_the_start_names_the_run_folder(tmp_path: Path) -> None:
    def fill(folder: RunFolder) -> None:
        raise RunError("No space left on device", where=str(folder.path / "checkpoint"))

    with pytest.raises(RunError, match="No space left") as caught:
        RunFolder(tmp_path / "run").create("name: x\n", {}, {}, fill)
    assert caught.value.where == str(tmp_path / "run")
    assert "free some disk space" in caught.value.fix
    assert names(tmp_path) == []


def test_metrics_lines_are_averages_and_json(tmp_path: Path) -> None:
    log = MetricsLog(RunFolder(tmp_path).append_metrics, {})
    for number in range(1, 76):
        extra = {"rare": float("inf")} if number == 60 else {}
        log.add(Iteration(number, float(number), 7, extra), 0.5 * number, last=number == 75)
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert lines == [
        {"iteration": 50, "seconds": 25.0, "gaussians": 7, "loss": 25.5},
        {"iteration": 75, "seconds": 37.5, "gaussians": 7, "loss": 63.0, "rare": None},
    ]


def test_metrics_of_iterations_to_repeat_are_removed(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    run.forget_metrics_after(10)
    for iteration in (50, 100, 150):
        run.append_metrics({"iteration": iteration})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 2')
    run.forget_metrics_after(100)
    assert (tmp_path / "metrics.jsonl").read_text() == '{"iteration": 50}\n{"iteration": 100}\n'


@pytest.mark.parametrize(
    ("file", "content", "told"),
    [
        ("provenance.json", '{"run": null}', "run: "),
        ("provenance.json", '{"resumed": 5}', "resumed: "),
        ("provenance.json", "[" * 100_000, "recursion"),
        ("inputs.json", '{"digests": [1, 2]}', "digests: "),
        ("inputs.json", '{"digests": {"the points": 5}}', "digests.the points: "),
        ("inputs.json", '{"digests": {}, "changed": [5]}', "changed.0: "),
        ("inputs.json", "[]", "all of it: "),
        ("initialization/facts.json", '{"seconds": "x"}', "seconds: "),
        ("initialization/facts.json", '{"seconds": 1e999}', "seconds: "),
        ("initialization/facts.json", '{"seconds": 1', "line 1"),
    ],
)
def test_a_damaged_file_is_named_with_its_field(
    tmp_path: Path, file: str, content: str, told: str
) -> None:
    run = RunFolder(tmp_path)
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(content)
    with pytest.raises(RunError, match="is damaged") as caught:
        _ = run.identity, run.inputs(), run.initialization()
    assert told in caught.value.what
    assert caught.value.where == str(tmp_path / file)


def test_invalid_lines_of_metrics_are_removed(tmp_path: Path) -> None:
    lines = [
        b'{"iteration": 1}',
        b"\xff\x00",
        b"[" * 100_000,
        b"[]",
        b'{"iteration": 9}',
        b'{"iter',
    ]
    (tmp_path / "metrics.jsonl").write_bytes(b"\n".join(lines))
    RunFolder(tmp_path).forget_metrics_after(5)
    assert (tmp_path / "metrics.jsonl").read_text() == '{"iteration": 1}\n'


def test_damaged_results_are_explained(tmp_path: Path) -> None:
    assert RunFolder(tmp_path).results() == {}
    for content in ("{", "[]", "[" * 100_000, '{"hash": "short"}', '{"test": {"psnr": true}}'):
        (tmp_path / "results.json").write_text(content)
        with pytest.raises(RunError, match="is inconsistent") as caught:
            RunFolder(tmp_path).results()
        assert "stereogs eval" in caught.value.fix
