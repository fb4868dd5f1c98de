from __future__ import annotations

import io
import json
import math
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console
from torch import Tensor

import registry.runs.training_run as training_run
from core_rasterizer import Device, ExplainedError, load_ply
from registry import Fact, PluginError, RunError, Scene, SceneError
from registry.pipeline.pipeline import Pipeline, load_pipeline, parse_pipeline
from registry.plugins.discovery import Plugins
from registry.runs.folder import RunFolder
from registry.runs.observing.metrics_log import MetricsLog
from registry.runs.origin.source_code import checkout
from registry.runs.run import Run
from registry.runs.training_run import open_run, resume, start
from registry.training.checkpoint import read_checkpoint, write_checkpoint
from registry.training.trainer import Trainer
from tests.registry.toy_plugin import ToyPoints, ToyPsnr, ToyScene

TEXT = """\
name: toy
scene: {use: toy_scene, path: here}
initializer: toy_points
regularizers: [{use: toy_term, weight: 0.1}]
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 10, stop: 25}
opacity: {use: toy_fade, every: 7}
metrics: [psnr]
exporters: [toy_files]
reports: [toy_report]
training: {iterations: 30, sh_degree: 1, sh_every: 10, evaluate_every: 20}
"""


def pipeline(plugins: Plugins, *overrides: str) -> Pipeline:
    return parse_pipeline(TEXT, plugins, source="toy.yaml", overrides=overrides)


def run(
    plugins: Plugins, device: Device, out: Path, *overrides: str
) -> tuple[RunFolder, bool, str]:
    stream = io.StringIO()
    done = start(
        pipeline(plugins, *overrides), device=device, out=out, console=Console(file=stream)
    )
    return done.folder_or_refuse(), done.finished, stream.getvalue()


def resumed(path: Path, plugins: Plugins, device: Device) -> Run:
    return resume(path, plugins=plugins, device=device, console=Console(file=io.StringIO()))


def test_everything_that_a_run_leaves(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, finished, output = run(toys, device, tmp_path / "run")
    assert finished
    assert "2 training views, 1 test views" in output
    assert "iteration 30/30" in output
    results = json.loads((folder.path / "results.json").read_text())
    assert results["test"].keys() == results["train"].keys() == {"psnr"}
    assert results["views"]["test"]["view1"] == results["test"]
    assert results["scene"]["train"] == ["view0", "view2"]
    assert (results["iterations"], len(results["hash"])) == (30, 64)
    assert results["gaussians"] > 0
    assert results["seconds"] > 0
    stages = ["scene", "initialization", "training", "evaluation", "outputs"]
    assert list(results["stages"]) == stages
    assert min(results["stages"].values()) > 0
    assert results["stages"]["training"] == results["seconds"]
    assert results["stages"]["initialization"] == results["initialization"]["seconds"] > 0
    assert results["seconds_total"] == pytest.approx(sum(results["stages"].values()))
    assert results["iterations_per_second"] == pytest.approx(30 / results["seconds"], rel=0.01)
    assert 10 < results["peak_memory_mb"] < 100_000
    assert results["device"]["name"] == device.name
    assert results["exports"] == ["exports/count.txt"]
    assert (folder.path / "exports/count.txt").read_text() == str(results["gaussians"])
    assert (folder.path / "report.txt").is_file()
    renders = folder.path / "renders"
    names = {str(path.relative_to(renders)) for path in renders.rglob("*.png")}
    assert names == {"view1.png", "depth/view1.png", "comparison/view1.png"}
    facts = json.loads((folder.path / "provenance.json").read_text())
    assert facts["resumed"] == []
    assert facts["device"]["driver"] == device.driver
    assert facts["packages"].keys() >= {"stereogs-plugins", "numpy", "pyopencl", "safetensors"}
    assert "not installed" not in facts["packages"].values()
    assert facts["plugin_sources"] == {"unknown package": None}
    assert facts["plugins"]["regularizers.toy_term"] == "unknown package ?"
    assert facts["command"] == sys.argv
    assert facts["source"] == checkout()
    assert facts["packages"]["torch"] == torch.__version__
    lines = [json.loads(x) for x in (folder.path / "metrics.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == [20, 30]
    assert "psnr" in lines[0]["test"]
    assert lines[1]["gaussians"] == results["gaussians"]
    assert {"loss", "photometric", "regularizers.toy_term", "calls"} <= lines[1].keys()
    again = parse_pipeline((folder.path / "pipeline.yaml").read_text(), toys)
    assert again == pipeline(toys)


def test_facts_of_components_stand_beside_the_hosts(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load, initialize = ToyScene.load, ToyPoints.initialize
    facts = (Fact("width", 7), Fact("test", "none"), Fact("paint", 3, affects_scores=False))
    points = {"seconds": -1.0, "tries": 2}
    monkeypatch.setattr(ToyScene, "load", lambda self: replace(load(self), facts=facts))
    monkeypatch.setattr(
        ToyPoints,
        "initialize",
        lambda self, scene, priors: replace(initialize(self, scene, priors), facts=points),
    )
    results = run(toys, device, tmp_path / "run")[0].results()
    scene = results["scene"]
    assert (scene["width"], scene["test"]) == (32, ["view1"])
    assert scene["facts"] == {"width": 7, "test": "none"}
    assert scene["notes"] == {"paint": 3}
    assert results["initialization"]["tries"] == 2
    assert results["initialization"]["seconds"] >= 0


def test_one_seed_one_hash(toys: Plugins, device: Device, tmp_path: Path) -> None:
    first, second, other = (
        run(toys, device, tmp_path / name, f"training.seed={seed}")[0].results()["hash"]
        for name, seed in (("a", 5), ("b", 5), ("c", 6))
    )
    assert first == second != other


def test_evaluations_on_the_way_leave_the_bits_as_they_are(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    hashes = {}
    for iterations, every, expected in ((30, 0, []), (30, 7, [7, 14, 21, 28])):
        folder = run(
            toys,
            device,
            tmp_path / f"{iterations}-{every}",
            f"training.evaluate_every={every}",
            f"training.iterations={iterations}",
        )[0]
        assert _evaluated(folder) == expected
        hashes[every] = folder.results()["hash"]
    assert hashes[0] == hashes[7]


def test_a_run_is_evaluated_at_each_quarter_unless_it_is_short(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    for iterations, expected in ((203, [50, 100, 150, 200]), (30, [])):
        changes = ("training.evaluate_every=null", f"training.iterations={iterations}")
        folder = run(toys, device, tmp_path / str(iterations), *changes)[0]
        assert _evaluated(folder) == expected


def test_a_metric_that_takes_long_is_measured_of_test_views_at_the_end(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = property(lambda metric: metric.context.name == "slow")
    monkeypatch.setattr(ToyPsnr, "takes_long", slow)
    changes = ("metrics=[psnr, {use: psnr, name: slow}]", "training.iterations=25")
    folder = run(toys, device, tmp_path / "run", *changes)[0]
    results = folder.results()
    assert results["test"].keys() == {"psnr", "slow"}
    assert results["train"].keys() == {"psnr"}
    lines = map(json.loads, (folder.path / "metrics.jsonl").read_text().splitlines())
    assert [line["test"].keys() for line in lines if "test" in line] == [{"psnr"}]


def _evaluated(folder: RunFolder) -> list[int]:
    """The iterations after which test views were scored."""
    lines = map(json.loads, (folder.path / "metrics.jsonl").read_text().splitlines())
    return [line["iteration"] for line in lines if "test" in line]


@pytest.fixture
def _ctrl_c_as_on_a_terminal() -> Iterator[None]:
    """A shell's background job ignores Ctrl-C, and so would the tests in it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c_as_on_a_terminal")
@pytest.mark.parametrize(
    ("iteration", "number"), [(1, signal.SIGINT), (10, signal.SIGTERM), (17, signal.SIGINT)]
)
def test_a_signal_then_resume_ends_in_the_same_bits(
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    iteration: int,
    number: signal.Signals,
) -> None:
    whole = run(toys, device, tmp_path / "whole")[0].results()

    def add_and_interrupt(self: MetricsLog, done: Any, seconds: float, *, last: bool) -> None:
        if done.number == iteration:
            signal.raise_signal(number)

    with monkeypatch.context() as patch:
        patch.setattr(MetricsLog, "add", add_and_interrupt)
        folder, finished, _ = run(toys, device, tmp_path / "parts")
    assert not finished
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert not (folder.path / "results.json").exists()
    opened = open_run(folder.path, plugins=toys, device=device)
    assert opened.iteration == iteration
    assert resumed(folder.path, toys, device).finished
    results = folder.results()
    assert results["hash"] == whole["hash"]
    assert results["test"] == whole["test"]
    assert results["gaussians"] == whole["gaussians"]
    (again,) = json.loads((folder.path / "provenance.json").read_text())["resumed"]
    assert (again["after"], again["device"]["name"]) == (iteration, device.name)


def test_a_second_ctrl_c_stops_at_once(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def impatient(self: MetricsLog, done: Any, seconds: float, *, last: bool) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(MetricsLog, "add", impatient)
    with pytest.raises(KeyboardInterrupt):
        run(toys, device, tmp_path / "run")


def test_a_finished_run_may_be_resumed_to_the_same_results(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    before = folder.results()
    (folder.path / "results.json").unlink()
    assert resumed(folder.path, toys, device).finished
    assert folder.results()["hash"] == before["hash"]
    assert folder.results()["test"] == before["test"]


def test_a_failure_leaves_the_last_checkpoint(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with pytest.raises(PluginError, match="not finite") as caught:
        run(
            toys,
            device,
            out,
            "regularizers.toy_term.fault=nan",
            "regularizers.toy_term.start=21",
            "training.checkpoint_every=8",
        )
    assert "iteration 21" in caught.value.where
    assert open_run(out, plugins=toys, device=device).iteration == 16


@pytest.mark.parametrize(
    ("overrides", "kind", "message"),
    [
        (["scene.mode=missing"], SceneError, "no photographs"),
        (["scene.mode=crash"], PluginError, "boom"),
        (["initializer.count=0"], SceneError, "no points"),
    ],
)
def test_bad_input_leaves_no_folder(
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    overrides: list[str],
    kind: type[ExplainedError],
    message: str,
) -> None:
    with pytest.raises(kind, match=message) as caught:
        run(toys, device, tmp_path / "deep" / "run", *overrides)
    assert "toy.yaml:" in caught.value.where or "--set" in caught.value.where
    assert list(tmp_path.iterdir()) == []


def test_a_full_folder_is_refused_before_anything_is_loaded(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="not empty"):
        run(toys, device, tmp_path, "scene.mode=crash")


def test_a_scene_without_test_views(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, finished, _ = run(toys, device, tmp_path / "run", "scene.test_views=0")
    assert finished
    results = folder.results()
    assert results["test"] == {}
    assert "psnr" in results["train"]
    assert not (folder.path / "renders").exists()


def test_the_scene_is_loaded_anew_by_its_own_settings(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run", "scene.test_views=0")
    opened = open_run(folder.path, plugins=toys, device=device)
    assert opened.scene.test == ()
    assert opened.model.digest() == folder.results()["hash"]


def test_the_module_writes_with_the_projects_own_plugins(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS", raising=False)
    small = ["scene.width=64", "scene.height=48", "training.iterations=320"]
    chosen = load_pipeline(Path("demo"), Plugins(), overrides=small)
    done = start(chosen, device=device, out=tmp_path / "run", console=Console(file=io.StringIO()))
    assert done.finished
    folder = done.folder_or_refuse()
    results = folder.results()
    assert results["train"]["psnr"] > 22
    assert 0 < results["test"]["ssim"] < 1
    assert len(load_ply(folder.path / "exports" / "scene.ply")) == results["gaussians"]


def test_changed_inputs_are_refused_unless_accepted(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    load = ToyScene.load

    def darker(self: ToyScene) -> Scene:
        scene = load(self)
        first = replace(scene.train[0], image=scene.train[0].image * 0.5)
        return replace(scene, train=(first, *scene.train[1:]))

    monkeypatch.setattr(ToyScene, "load", darker)
    quiet = Console(file=io.StringIO())
    with pytest.raises(RunError, match="changed: the photograph of view0\n") as caught:
        resume(folder.path, plugins=toys, device=device, console=quiet)
    assert "--accept-changed-inputs" in caught.value.fix
    assert folder.results()["changed_inputs"] == []
    again = resume(
        folder.path, plugins=toys, device=device, console=quiet, accept_changed_inputs=True
    )
    assert again.finished
    assert folder.results()["changed_inputs"] == ["the photograph of view0"]
    assert open_run(folder.path, plugins=toys, device=device).changed == ()


def test_a_run_that_kept_no_digests_goes_on(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    (folder.path / "inputs.json").unlink()
    assert open_run(folder.path, plugins=toys, device=device).changed == ()


EDITS = {
    "iterations: 30": ("iterations: 60", "`iterations: 60` in place of `iterations: 30`"),
    "seed: 0": ("seed: 5", "`seed: 5` in place of `seed: 0`"),
    "weight: 0.1": ("weight: 0.2", "`weight: 0.2` in place of `weight: 0.1`"),
    "opacity: 0.05": ("opacity: 0.06", "`opacity: 0.06` in place of `opacity: 0.05`"),
}


@pytest.mark.parametrize(("line", "edit", "said"), [(k, *v) for k, v in EDITS.items()])
def test_an_edited_pipeline_is_refused_with_its_line(
    toys: Plugins, device: Device, tmp_path: Path, line: str, edit: str, said: str
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    text = folder.pipeline.read_text()
    assert line in text
    folder.pipeline.write_text(f"# a comment means nothing\n{text}")
    assert open_run(folder.path, plugins=toys, device=device).finished
    folder.pipeline.write_text(text.replace(line, edit))
    with pytest.raises(RunError, match="not the one that the run was made with") as caught:
        resumed(folder.path, toys, device)
    assert said in caught.value.what
    number = int(caught.value.where.rpartition(":")[2])
    assert folder.pipeline.read_text().splitlines()[number - 1].strip() in caught.value.what


def newest(folder: RunFolder) -> Path:
    return max((folder.path / "checkpoint").iterdir())


def test_another_runs_checkpoint_is_refused(toys: Plugins, device: Device, tmp_path: Path) -> None:
    mine, other = (run(toys, device, tmp_path / name)[0] for name in ("mine", "other"))
    shutil.rmtree(mine.path / "checkpoint")
    shutil.copytree(other.path / "checkpoint", mine.path / "checkpoint")
    with pytest.raises(RunError, match="another run's"):
        resumed(mine.path, toys, device)


def written_anew(folder: RunFolder, **changes: Any) -> None:
    """A newest checkpoint that somebody has changed, hashes and all."""
    place = newest(folder)
    forged = replace(read_checkpoint(place), **changes)
    shutil.rmtree(place)
    write_checkpoint(forged, place)


def test_an_iteration_beyond_the_end_is_refused(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    written_anew(folder, iteration=1_000_000_000)
    with pytest.raises(RunError, match="says iteration 1000000000, and the run has 30"):
        resumed(folder.path, toys, device)


MISFITS: dict[str, Callable[[Tensor], Tensor | None]] = {
    "model/means": lambda t: t[:-1],
    "model/sh": lambda t: None,
    "model/opacity_logits": lambda t: t * math.nan,
    "optimizer/first_moments": lambda t: t[:, :1],
    "optimizer/steps": lambda t: None,
    "statistics/screen": lambda t: t[:, :1],
    "topology/generator": lambda t: t[:9],
    "views/left": lambda t: torch.tensor([7]),
    "views/generator": lambda t: None,
    "components/regularizers.toy_term/generator": lambda t: t.float(),
    "components/regularizers.toy_term/state/calls": lambda t: None,
}


def test_state_that_does_not_fit_is_explained(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    tensors = read_checkpoint(newest(folder)).tensors
    for name, change in MISFITS.items():
        changed = change(tensors[name])
        rest = {key: value for key, value in tensors.items() if key != name}
        written_anew(folder, tensors=rest if changed is None else {**rest, name: changed})
        with pytest.raises(ExplainedError) as caught:
            resumed(folder.path, toys, device)
        assert "checkpoint" in caught.value.where, name


def test_a_damaged_checkpoint_costs_iterations_and_not_the_run(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run", "training.checkpoint_every=20")
    before = folder.results()
    (newest(folder) / "tensors.safetensors").write_bytes(b"")
    again = resumed(folder.path, toys, device)
    assert again.finished
    assert folder.results()["hash"] == before["hash"]
    assert [line["iteration"] for line in again.metrics] == [30]


def test_a_run_can_be_resumed_from_its_first_moment(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run(toys, device, tmp_path / "whole")[0].results()

    def die(self: Trainer) -> None:
        raise SystemError

    monkeypatch.setattr(Trainer, "run", die)
    with pytest.raises(SystemError):
        run(toys, device, tmp_path / "run")
    monkeypatch.undo()
    assert resumed(tmp_path / "run", toys, device).hash == whole["hash"]


def test_checkpoints_are_saved_by_the_clock_too(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[int] = []
    save = Run.save_checkpoint

    def noted(self: Run) -> None:
        saved.append(self.iteration)
        save(self)

    monkeypatch.setattr(Run, "save_checkpoint", noted)
    run(toys, device, tmp_path / "slow")
    assert saved == [30]
    monkeypatch.setattr(training_run, "AUTOMATIC_SECONDS", 0.0)
    monkeypatch.setattr(training_run, "AUTOMATIC_SHARE", 1e9)
    saved.clear()
    folder, _, _ = run(toys, device, tmp_path / "quick", "training.iterations=3")
    assert saved == [1, 2, 3, 3]
    assert [path.name for path in sorted((folder.path / "checkpoint").iterdir())] == [
        "iteration-0000002",
        "iteration-0000003",
    ]


def test_a_run_at_work_is_left_alone(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    lines = (folder.path / "metrics.jsonl").read_text()
    with folder.to_itself(), pytest.raises(RunError, match="in use by another process"):
        resumed(folder.path, toys, device)
    assert (folder.path / "metrics.jsonl").read_text() == lines
