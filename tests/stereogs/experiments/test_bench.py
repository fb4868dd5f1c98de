"""A matrix of pipelines, lengths, scenes and seeds: planned, refused, and trained by any runner."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from rich.console import Console

from core_rasterizer import Device
from registry import Context, PluginError, Settings
from registry.runners import Runner, RunningTask, TrainingTask
from stereogs import ExplainedError, RunOptions
from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import Plan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.running.local_processes import LocalProcesses
from stereogs.experiments.running.pool import RUNNER, choose_runner, train_all
from tests.host import (
    SELECTION,
    HostSettings,
    Item,
    Offer,
    Part,
    PipelineError,
    Place,
    Plugins,
    main,
    parse_pipeline,
    parse_yaml,
    start_run,
)
from tests.stereogs.experiments.ablating import PIPELINE, write

MATRIX = """\
pipelines: [toy, ./other.yaml]
scenes: [{use: toy_scene, name: garden}, {use: toy_scene, name: yard}]
iterations: [2, 5]
seeds: 2
"""


def matrix(folder: Path, text: str = MATRIX) -> Path:
    """Write a matrix file and its pipelines."""
    write(folder)
    other = PIPELINE.replace("name: toy", "name: other").replace("opacity: {use: toy_fade", "#")
    (folder / "other.yaml").write_text(other)
    path = folder / "matrix.yaml"
    path.write_text(text.replace("[toy,", "[toy.yaml,"))
    return path


def plan(toys: Plugins, folder: Path, text: str = MATRIX) -> Plan:
    return plan_of(read_matrix(matrix(folder, text)), toys)


def test_every_pipeline_length_scene_and_seed_once(toys: Plugins, tmp_path: Path) -> None:
    made = plan(toys, tmp_path)
    assert made.size == "4 combinations x 2 scenes x 2 seeds = 16 runs"
    assert len({run.digest for run in made.runs}) == 16
    seen = [
        (run.pipeline.name, run.pipeline.training.iterations, run.scene, run.pipeline.training.seed)
        for run in made.runs
    ]
    assert seen[:4] == [
        ("toy", 2, "garden", 0),
        ("toy", 2, "garden", 1),
        ("toy", 2, "yard", 0),
        ("toy", 2, "yard", 1),
    ]
    assert seen[-1] == ("other", 5, "yard", 1)
    assert made.describe(made.combinations[0]) == "pipeline toy, training.iterations 2"


def test_without_lengths_each_pipeline_has_its_own(toys: Plugins, tmp_path: Path) -> None:
    made = plan(toys, tmp_path, MATRIX.replace("iterations: [2, 5]\n", ""))
    assert {run.pipeline.training.iterations for run in made.runs} == {5}
    assert [variation.name for variation in made.variations] == ["pipeline"]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("pipelines:", "pipeline:", "no key 'pipeline'; did you mean 'pipelines'"),
        ("pipelines: [toy, ./other.yaml]\n", "", "lists no pipelines"),
        ("[toy, ./other.yaml]", "[]", "is empty"),
        ("[toy, ./other.yaml]", "[toy.yaml, ./toy.yaml]", "two pipelines are called 'toy'"),
        ("[toy, ./other.yaml]", "[toy, ./missing.yaml]", "missing"),
        ("scenes:", "#", "lists no scenes"),
        ("[2, 5]", "[2, 2]", "the value 2 twice"),
        ("[2, 5]", "[0]", "iterations"),
        ("seeds: 2", "seeds: 0", "1 or more"),
    ],
)
def test_an_invalid_matrix_is_rejected(
    toys: Plugins, tmp_path: Path, old: str, new: str, what: str
) -> None:
    assert old in MATRIX
    with pytest.raises(ExplainedError) as refused:
        plan(toys, tmp_path, MATRIX.replace(old, new))
    assert what in str(refused.value)
    assert "matrix.yaml" in refused.value.where or "missing" in refused.value.where


class InThisProcess(Runner[Settings]):
    """A runner of another package, which trains when `ended` is read."""

    def __init__(self, settings: Settings, context: Context) -> None:
        super().__init__(settings, context)
        self.toys = Plugins(())
        self.most = self.at_work = 0
        self.closed = False

    @property
    def places(self) -> int:
        return 3

    def start(self, task: TrainingTask) -> RunningTask:
        self.at_work += 1
        self.most = max(self.most, self.at_work)
        return _Task(task, self)

    def close(self) -> None:
        self.closed = True


class _Task(RunningTask):
    def __init__(self, task: TrainingTask, runner: InThisProcess) -> None:
        self._task, self._runner = task, runner
        self._failure: str | None = None

    @property
    def ended(self) -> bool:
        if self._failure is None:
            self._runner.at_work -= 1
            self._failure = self._train()
        return True

    def _train(self) -> str:
        pipeline = parse_pipeline(self._task.pipeline, self._runner.toys)
        if pipeline.training.seed == 1:
            return "seed 1 is not for me"
        start_run(
            pipeline,
            RunOptions(device=self._runner.context.device, progress=False),
            self._task.folder,
        )
        return ""

    def failure(self) -> str:
        assert self._failure is not None
        return self._failure

    def stop(self) -> None: ...

    def kill(self) -> None: ...


def test_any_runner_trains_a_plan(toys: Plugins, device: Device, tmp_path: Path) -> None:
    offer = Offer(RUNNER, "mine", InThisProcess, "mine", "a package", "1")
    runner = InThisProcess(Settings(), Context("mine", 0, device))
    runner.toys = toys
    item = Item("mine", Settings(), HostSettings(use="mine"), offer, Place("a test"))
    made = plan(toys, tmp_path, MATRIX.replace("iterations: [2, 5]\n", "iterations: [2]\n"))
    folder = ExperimentFolder(tmp_path / "out")
    console = Console(file=io.StringIO())
    outcome = train_all(made.runs, folder, Part(item, runner), device=None, console=console)
    assert {run.seed for run in outcome.failures} == {1}
    assert set(outcome.failures.values()) == {"seed 1 is not for me"}
    assert [bool(folder.results(run)) for run in made.runs] == [True, False] * 4
    assert runner.most == 3
    assert runner.closed


def test_an_error_of_a_runner_names_it(toys: Plugins, device: Device, tmp_path: Path) -> None:
    class Broken(InThisProcess):
        def start(self, task: TrainingTask) -> RunningTask:
            raise ZeroDivisionError("nowhere to go")

    offer = Offer(RUNNER, "broken", Broken, "broken", "a package", "1")
    item = Item("broken", Settings(), HostSettings(use="broken"), offer, Place("matrix.yaml:5"))
    runner = Part(item, Broken(Settings(), Context("broken", 0, device)))
    made = plan(toys, tmp_path)
    folder = ExperimentFolder(tmp_path / "out")
    with pytest.raises(PluginError, match="nowhere to go") as failed:
        train_all(made.runs, folder, runner, device=None, console=Console(file=io.StringIO()))
    assert "the runner 'broken' failed" in failed.value.what
    assert "matrix.yaml:5" in failed.value.where


def test_the_default_runner(device: Device) -> None:
    plugins = Plugins(())
    usual = choose_runner(None, None, plugins, device)
    assert isinstance(usual.component, LocalProcesses)
    written = choose_runner(
        parse_yaml("{use: local, jobs: 3}", "m", has_lines=False), None, plugins, device
    )
    assert written.component.places == 3
    assert choose_runner(None, 2, plugins, device).component.places == 2
    with pytest.raises(PipelineError, match="the named runner decides"):
        choose_runner(parse_yaml("{use: far_away}", "m", has_lines=False), 2, plugins, device)
    with pytest.raises(PluginError, match="no plugin offers the runner 'far_away'"):
        choose_runner(parse_yaml("far_away", "m", has_lines=False), None, plugins, device)


TINY = """\
name: tiny
scene: {use: procedural, width: 32, height: 24, test_views: 1, points: 100}
initializer: sfm
metrics: [psnr]
training: {iterations: 3, sh_degree: 0}
"""


@pytest.mark.proof
def test_a_bench_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(SELECTION, "procedural,sfm,psnr")
    (tmp_path / "tiny.yaml").write_text(TINY)
    path, out = tmp_path / "small.yaml", tmp_path / "out"
    path.write_text(
        "pipelines: [tiny.yaml]\nscenes:\n- {use: procedural, width: 32, height: 24, "
        "test_views: 1, points: 100}\niterations: [1, 3]\n"
    )
    command = ["bench", str(path), "--out", str(out), "--jobs", "2"]
    assert main(command) == 0
    assert "2 combinations x 1 scene x 1 seed = 2 runs, 0 finished" in capsys.readouterr().out
    rows = list(csv.DictReader(io.StringIO((out / "bench.csv").read_text())))
    assert [row["training.iterations"] for row in rows] == ["1", "3"]
    assert float(rows[0]["psnr"]) < float(rows[1]["psnr"])
    assert "<h1>Bench: small" in (out / "index.html").read_text("utf-8")
    assert main(command) == 0
    assert "2 runs, 2 finished" in capsys.readouterr().out
