from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from registry import RunError
from registry.files import new_folder, replacing, write_text
from registry.runs.folder import RunFolder, default_folder
from registry.runs.metrics_log import MetricsLog
from registry.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from registry.training.trainer import Iteration


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_run_folder_has_its_files_or_does_not_exist(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "deep" / "run")
    run.create("name: x\n", {"seed": 1}, {"the points": "ab"})
    assert sorted(p.name for p in run.path.iterdir()) == [
        "inputs.json",
        "pipeline.yaml",
        "provenance.json",
    ]
    assert run.inputs() == ({"the points": "ab"}, [])
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["run"]
    other = RunFolder(tmp_path / "other")
    with pytest.raises(TypeError):
        other.create("name: x\n", {"seed": object()}, {})
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]


def test_an_empty_folder_is_taken_and_a_full_one_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    RunFolder(empty).create("name: x\n", {}, {})
    with pytest.raises(RunError, match="not empty") as caught:
        RunFolder(empty).create("name: x\n", {}, {})
    assert "--resume" in caught.value.fix


def test_places_where_nothing_can_be_written(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(RunError, match="in the way"):
        RunFolder.check_vacant(file)
    with pytest.raises(RunError, match="nothing can be written"):
        RunFolder.check_vacant(file / "below")
    RunFolder.check_vacant(tmp_path / "a" / "b")
    assert not (tmp_path / "a").exists()


def test_something_else_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="not a run folder"):
        RunFolder.existing(tmp_path)


def test_default_folders_are_numbered() -> None:
    taken = {Path("runs/a-b"), Path("runs/a-b-2")}
    assert default_folder("a b", taken.__contains__) == Path("runs/a-b-3")
    assert default_folder("../ü/..", taken.__contains__).parent == Path("runs")
    assert default_folder("///", taken.__contains__) == Path("runs/run")


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_a_folder_that_fails_vanishes(tmp_path: Path) -> None:
    def fail() -> None:
        with new_folder(tmp_path / "x") as folder:
            (folder / "file").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert names(tmp_path) == []


def test_metrics_lines_are_averages_and_json(tmp_path: Path) -> None:
    log = MetricsLog(RunFolder(tmp_path).append_metrics)
    for number in range(1, 76):
        extra = {"rare": float("inf")} if number == 60 else {}
        log.add(Iteration(number, float(number), 7, extra), 0.5 * number, last=number == 75)
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert lines == [
        {"iteration": 50, "seconds": 25.0, "gaussians": 7, "loss": 25.5},
        {"iteration": 75, "seconds": 37.5, "gaussians": 7, "loss": 63.0, "rare": None},
    ]


def test_metrics_of_iterations_to_be_done_again_are_forgotten(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    run.forget_metrics_after(10)
    for iteration in (50, 100, 150):
        run.append_metrics({"iteration": iteration})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 2')
    run.forget_metrics_after(100)
    assert (tmp_path / "metrics.jsonl").read_text() == '{"iteration": 50}\n{"iteration": 100}\n'


def test_damaged_results_are_explained(tmp_path: Path) -> None:
    assert RunFolder(tmp_path).results() == {}
    (tmp_path / "results.json").write_text("{")
    with pytest.raises(RunError, match="damaged"):
        RunFolder(tmp_path).results()


def checkpoint(iteration: int) -> Checkpoint:
    tensors = {"model/means": torch.full((2, 3), float(iteration)), "views/left": torch.arange(3)}
    return Checkpoint(iteration, 1.5, tensors)


def test_checkpoints_replace_one_another(tmp_path: Path) -> None:
    for iteration in (10, 20):
        save_checkpoint(checkpoint(iteration), tmp_path)
    assert names(tmp_path) == ["iteration-0000020.safetensors", "manifest.json"]
    loaded = load_checkpoint(tmp_path)
    assert (loaded.iteration, loaded.seconds) == (20, 1.5)
    assert list(loaded.part("model")) == ["means"]
    assert torch.equal(loaded.part("views")["left"], torch.arange(3))


def test_a_write_that_breaks_off_leaves_the_old_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_checkpoint(checkpoint(10), tmp_path)

    def full_disk(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(RunError, match="No space left"):
        save_checkpoint(checkpoint(20), tmp_path)
    assert load_checkpoint(tmp_path).iteration == 10


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("manifest.json", b"{", "cannot be read"),
        ("manifest.json", b'{"format": 99}', "format 99"),
        ("manifest.json", b'{"format": 1}', "cannot be read"),
        ("manifest.json", b"[]", "cannot be read"),
        ("iteration-0000010.safetensors", b"", "cannot be read"),
        ("iteration-0000010.safetensors", b"\xff" * 100, "cannot be read"),
    ],
)
def test_damaged_checkpoints_are_explained(
    tmp_path: Path, file: str, content: bytes, message: str
) -> None:
    save_checkpoint(checkpoint(10), tmp_path)
    (tmp_path / file).write_bytes(content)
    with pytest.raises(RunError, match=message):
        load_checkpoint(tmp_path)


def test_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no checkpoint"):
        load_checkpoint(tmp_path)
