"""Train the runs of an ablation in processes, stop, resume and repeat them."""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from rich.console import Console

from core_rasterizer import Device
from registry import RunError
from stereogs import RunOptions, open_run
from stereogs.experiments.planning.plan import PlannedRun
from stereogs.experiments.running import local_processes, pool
from stereogs.experiments.running.folder import ExperimentFolder, Shard
from stereogs.experiments.running.local_processes import LocalProcesses
from stereogs.experiments.running.pool import PoolProgress, choose_runner, train_all
from stereogs.experiments.running.worker import training_arguments
from tests.host import SELECTION, MetricsLog, Part, Plugins, main, start_run
from tests.html_page import Page
from tests.stereogs.experiments.ablating import plan, write
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff

TINY = """\
name: tiny
scene: {use: procedural, width: 32, height: 24, test_views: 1, points: 100}
initializer: sfm
modifiers: [dropout]
metrics: [psnr]
training: {iterations: 5, sh_degree: 0}
"""


def table(folder: Path) -> dict[str, dict[str, str]]:
    """Return the rows of the CSV by the state of the dropout."""
    rows = csv.DictReader(io.StringIO((folder / "ablation.csv").read_text()))
    return {row["dropout"]: row for row in rows}


@pytest.mark.proof
def test_an_ablation_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr")
    pipeline, out = tmp_path / "tiny.yaml", tmp_path / "out"
    pipeline.write_text(TINY)
    command = ["ablate", str(pipeline), "--toggle", "dropout", "--out", str(out)]
    assert main([*command, "--jobs", "2"]) == 0
    printed = capsys.readouterr().out
    assert "2 combinations x 1 scene x 1 seed = 2 runs, 0 finished; 2 at a time" in printed
    first = table(out)
    for row in first.values():
        results = json.loads((out / row["folder"] / "results.json").read_text())
        assert float(row["psnr"]) == results["test"]["psnr"]
        assert row["hash"] == results["hash"]
        assert f"{results['test']['psnr']:.2f}" in (out / "ablation.txt").read_text()
    assert first["0"]["hash"] != first["1"]["hash"]
    assert (out / "ablation.txt").read_text() in printed
    assert r"\begin{tabular}{lrr" in (out / "ablation.tex").read_text()
    assert (out / "ablation_means.csv").read_text().startswith("dropout,scene,quantity,mean,")
    assert (out / "index.html").read_text("utf-8").count("<img") == 5

    # One run broken beyond repair: it alone is trained again, to the same bits.
    broken = out / first["1"]["folder"]
    shutil.rmtree(broken / "checkpoint")
    (broken / "results.json").unlink()
    untouched = (out / first["0"]["folder"] / "results.json").stat().st_mtime_ns
    assert main(command) == 0
    assert "2 runs, 1 finished; " in capsys.readouterr().out
    again = table(out)
    assert again["1"]["hash"] == first["1"]["hash"]
    assert again["1"]["psnr"] == first["1"]["psnr"]
    assert again["0"] == first["0"]
    assert (out / first["0"]["folder"] / "results.json").stat().st_mtime_ns == untouched


def test_the_page_shows_photographs_named_by_numbers(
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(SELECTION, "llff,random,psnr")
    capture = write_llff(tmp_path / "capture", World())
    for number, photograph in enumerate(sorted((capture / "images_2").iterdir())):
        with Image.open(photograph) as picture:
            picture.save(photograph.with_name(f"{number}.jpg"))
        photograph.unlink()
    pipeline, out = tmp_path / "numbers.yaml", tmp_path / "out"
    pipeline.write_text(
        f"name: numbers\nscene: {{use: llff, path: {capture}, downsample: 2}}\n"
        "initializer: {use: random, count: 50}\nmetrics: [psnr]\n"
        "training: {iterations: 2, sh_degree: 0}\n"
    )
    vary = "training.initial_opacity=0.1,0.2"
    for run in plan(pipeline, Plugins(), vary=(vary,)).runs:
        train_here(run, ExperimentFolder(out), device)
    assert main(["ablate", str(pipeline), "--vary", vary, "--out", str(out)]) == 0
    assert "2 finished" in capsys.readouterr().out
    page = Page((out / "index.html").read_text("utf-8"))
    assert "0: photograph" in page.text
    each_view = ["photograph", *["render", "depth"] * 2]
    assert [image["alt"] for image in page.images] == each_view * 2


@pytest.mark.proof
def test_a_failure_is_reported_and_other_results_are_kept(
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,initializers.ply,sfm,dropout,psnr")
    pipeline, out = tmp_path / "tiny.yaml", tmp_path / "out"
    pipeline.write_text(TINY)
    vary = "initializer={use: ply, path: missing.ply},sfm"
    _, good = plan(pipeline, Plugins(), vary=(vary,)).runs
    train_here(good, ExperimentFolder(out), device)
    command = ["ablate", str(pipeline), "--vary", vary, "--out", str(out)]
    assert main(command) == 2
    captured = capsys.readouterr()
    assert "1 of 2 runs failed; the first error:" in captured.err
    assert "missing.ply" in captured.err
    assert ".log" in captured.err
    text = (out / "ablation.txt").read_text()
    assert "0/1" in text
    assert "1/1" not in text


def test_scenes_are_loaded_before_the_first_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,llff,sfm,dropout,psnr")
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    pipeline, out = tmp_path / "tiny.yaml", tmp_path / "out"
    scene = "{use: procedural, width: 32, height: 24, test_views: 1, points: 100}"
    pipeline.write_text(TINY.replace(scene, "{use: llff, path: x}"))
    scenes = "procedural,{use: procedural, width: 32, height: 24}"
    command = ["ablate", str(pipeline), "--toggle", "dropout", "--seeds", "3", "--out", str(out)]
    assert main([*command, "--scenes", scenes]) == 2
    assert "two scenes are called 'procedural'" in capsys.readouterr().err
    scenes = scenes.replace("width", "name: small, width")
    assert main([*command, "--scenes", scenes]) == 2
    error = capsys.readouterr().err
    assert "1 of 2 scenes cannot be loaded, so nothing is trained" in error
    assert "written {use: procedural}" in error
    assert [*(out / "runs").iterdir()] == []


def toy_runs(toys: Plugins, folder: Path) -> tuple[PlannedRun, ...]:
    return plan(write(folder), toys, toggles="second").runs


def arguments_of(run: PlannedRun, folder: ExperimentFolder) -> list[str]:
    """Return the arguments of the process that would train a run."""
    pipeline = folder.path / "pipeline.yaml"
    pipeline.write_text(run.pipeline.to_yaml())
    return training_arguments(pipeline, folder.run(run).path)


def local(device: Device, lock: int | None = None) -> Part:
    """Return the default runner with one training at a time."""
    runner = choose_runner(None, 1, Plugins(()), device)
    assert isinstance(runner.component, LocalProcesses)
    runner.component.lock = lock
    return runner


def train_here(
    run: PlannedRun, folder: ExperimentFolder, device: Device, stop_at: int | None = None
) -> None:
    """Train a planned run in this process, interrupted after an iteration if one is given."""
    original: Callable[..., None] = MetricsLog.add

    def add(self: MetricsLog, done: Any, seconds: float, *, last: bool) -> None:
        original(self, done, seconds, last=last)
        if done.number == stop_at:
            signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MetricsLog, "add", add)
        start_run(
            run.pipeline,
            RunOptions(device=device, progress=False),
            folder.run(run).path,
        )


def test_an_interrupted_run_resumes_and_a_damaged_one_restarts(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    run = toy_runs(toys, tmp_path)[0]
    train_here(run, folder, device, stop_at=3)
    place = folder.run(run)
    assert folder.results(run) == {}
    assert arguments_of(run, folder) == ["resume", str(place.path)]
    for file in place.path.glob("checkpoint/*/tensors.safetensors"):
        file.write_bytes(b"damaged")
    verb, pipeline, *out = arguments_of(run, folder)
    assert verb == "train"
    assert out == ["--out", str(place.path)]
    assert Path(pipeline).read_text() == run.pipeline.to_yaml()
    assert not place.path.exists()
    train_here(run, folder, device)
    assert folder.results(run)["iterations"] == 5


def test_a_run_with_a_length_per_view_is_recognized(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr")
    pipeline = tmp_path / "tiny.yaml"
    pipeline.write_text(TINY.replace("iterations: 5", "iterations: 2 per view"))
    folder = ExperimentFolder(tmp_path / "out")
    run = plan(pipeline, Plugins(), toggles="dropout").runs[0]
    train_here(run, folder, device, stop_at=3)
    place = folder.run(run).path
    assert arguments_of(run, folder) == ["resume", str(place)]
    shutil.rmtree(place)
    train_here(run, folder, device)
    assert folder.results(run)["iterations"] == 2 * len(open_run(place, device=device).scene.train)


def test_ctrl_c_stops_active_runs_and_starts_no_more(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[int] = []

    def press_once(self: PoolProgress, parts: list[float]) -> None:
        shown.append(len(parts))
        if len(shown) == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(PoolProgress, "show", press_once)
    runs = toy_runs(toys, tmp_path)
    folder = ExperimentFolder(tmp_path / "out")
    with folder.locked() as lock:
        with pytest.raises(RunError, match="in use by another process"), folder.locked():
            pass
        console = Console(file=io.StringIO())
        outcome = train_all(runs, folder, local(device, lock), device=None, console=console)
    assert shown[0] == 1
    assert outcome.stopped
    assert outcome.failures == {}
    assert [folder.results(run) for run in runs] == [{}, {}]
    assert (tmp_path / "out" / "runs" / f"{runs[0].name}.log").exists()
    assert not (tmp_path / "out" / "runs" / f"{runs[1].name}.log").exists()
    with folder.locked():  # free again
        pass


def test_a_training_that_goes_on_after_ctrl_c_is_killed(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press_once(self: PoolProgress, parts: list[float]) -> None:
        if not stopped:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(PoolProgress, "show", press_once)
    monkeypatch.setattr(pool, "STOP_SECONDS", 0.0)
    monkeypatch.setattr(local_processes.TrainingProcess, "stop", lambda self: stopped.append(self))
    stopped: list[local_processes.TrainingProcess] = []
    folder, console = ExperimentFolder(tmp_path / "out"), Console(file=io.StringIO())
    with folder.locked() as lock:
        outcome = train_all(
            toy_runs(toys, tmp_path), folder, local(device, lock), device=None, console=console
        )
    assert outcome.stopped
    assert [process.ended for process in stopped] == [True]


def test_shards_use_one_folder_and_the_whole_writes_the_table(
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr")
    pipeline, folder = tmp_path / "tiny.yaml", ExperimentFolder(tmp_path / "out")
    pipeline.write_text(TINY)
    runs = plan(pipeline, Plugins(), toggles="dropout").runs
    assert [*Shard(1, 2).of(runs), *Shard(2, 2).of(runs)] == [*runs]
    command = ["ablate", str(pipeline), "--toggle", "dropout", "--out", str(folder.path)]
    train_here(runs[1], folder, device)
    with folder.locked(Shard(1, 2)):
        assert main([*command, "--shard", "2/2"]) == 0
        assert "1 finished; 0 to train" in capsys.readouterr().out
        assert main(command) == 2
        assert "in use by another process" in capsys.readouterr().err
    with folder.locked():
        assert main([*command, "--shard", "2/2"]) == 2
    train_here(runs[0], folder, device)
    assert main(command) == 0
    assert "2 finished; " in capsys.readouterr().out
    assert len(table(folder.path)) == 2
    for wrong in ("0/2", "3/2", "1", "a/b"):
        assert main([*command, "--shard", wrong]) == 2


def test_trainings_without_results_have_failed_and_do_not_stop_others(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    does_nothing = shutil.which("true")
    assert does_nothing
    monkeypatch.setattr(sys, "executable", does_nothing)
    runs = toy_runs(toys, tmp_path)
    folder = ExperimentFolder(tmp_path / "out")
    console = Console(file=io.StringIO())
    with folder.locked() as lock:
        outcome = train_all(runs, folder, local(device, lock), device=None, console=console)
    assert len(runs) == 2
    assert all("left no results" in outcome.failures[run] for run in runs)
    assert not outcome.stopped


@pytest.mark.parametrize(
    ("kind", "cores", "free", "peaks", "expected"),
    [
        ("cpu", 2, 64_000.0, [], 1),
        ("cpu", 16, 64_000.0, [], 4),
        ("cpu", 16, 5_000.0, [], 2),
        ("cpu", 16, 5_000.0, [700.0, 1_500.0], 3),
        ("cpu", 16, 100.0, [], 1),
        ("cpu", 16, math.inf, [], 1),
        ("gpu", 16, 64_000.0, [], 1),
    ],
)
def test_the_number_of_simultaneous_trainings(
    device: Device,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    cores: int,
    free: float,
    peaks: list[float],
    expected: int,
) -> None:
    monkeypatch.setattr(device, "kind", kind)
    monkeypatch.setattr(local_processes, "usable_cores", lambda: cores)
    monkeypatch.setattr(local_processes, "available_bytes", lambda: 1e6 * free)
    assert local_processes.default_jobs(device, peaks) == expected


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["none.yaml"], "cannot be read"),
        (["tiny.yaml"], "nothing to toggle"),
        (["tiny.yaml", "--toggle", "dropot"], "did you mean 'dropout'"),
        (["tiny.yaml", "--toggle", "dropout", "--jobs", "0"], "at least 1"),
        (["tiny.yaml", "--toggle", "dropout", "--device", "no such"], "no OpenCL device"),
        (["tiny.yaml", "--toggle", "dropout", "--out", "tiny.yaml"], "not writable"),
        (
            ["tiny.yaml", "--toggle", "dropout", "--pipeline", "x.yaml"],
            "--pipeline needs an ablation file",
        ),
    ],
)
def test_mistakes_print_one_message_and_write_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    what: str,
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,dropout,psnr")
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(TINY)
    assert main(["ablate", *arguments]) == 2
    assert what in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.yaml"]
