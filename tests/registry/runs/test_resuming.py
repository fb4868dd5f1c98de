from __future__ import annotations

import json
import math
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import registry.runs.training_run as training_run
from core_rasterizer import Device, ExplainedError, GaussianError
from registry import PluginError, RunError, Scene, Step
from registry.runs.folder import RunFolder
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.progress import MetricsLog
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from tests.host import Plugins, Trainer, read_checkpoint, write_checkpoint
from tests.registry.runs.toy_run import pipeline, resumed, run
from tests.registry.toy_plugin import ToyScene, ToyTerm


@pytest.fixture
def _default_interrupt_handler() -> Iterator[None]:
    """Handle Ctrl-C as on a terminal: background jobs of a shell ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.proof
@pytest.mark.usefixtures("_default_interrupt_handler")
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
    opened = load_run(folder.path, plugins=toys, device=device)
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


def test_a_resumed_run_writes_the_same_metrics(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    """The mean of a line covers the iterations before the stop too."""

    def lines(folder: Path) -> list[dict[str, Any]]:
        written = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
        return [{k: v for k, v in line.items() if k != "seconds"} for line in written]

    run(toys, device, tmp_path / "whole")
    options = RunOptions(device=device, progress=False, callback=lambda done: done.number < 17)
    start_run(pipeline(toys), options, tmp_path / "parts")
    assert resumed(tmp_path / "parts", toys, device).finished
    assert lines(tmp_path / "parts") == lines(tmp_path / "whole")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["manifest.json", "pipeline.yaml", "tensors.safetensors"])
def test_a_pipe_in_place_of_a_file_is_refused(
    toys: Plugins, device: Device, tmp_path: Path, name: str
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    for place in (folder.path / "checkpoint").iterdir():
        (place / name).unlink()
        os.mkfifo(place / name)
    with pytest.raises(RunError, match=f"{name} is missing, or not a file"):
        resumed(folder.path, toys, device)


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
    assert load_run(out, plugins=toys, device=device).iteration == 16


def spoiling(times: int, **options: Any) -> RunOptions:
    """Options of a run whose Gaussians are overwritten with NaN, unseen by the guards, after iteration 20."""
    runs: list[Run] = []

    def spoil(done: Any) -> None:
        nonlocal times
        if done.number == 20 and times:
            times -= 1
            model: Any = runs[-1].engine_model
            rows = model.parameters.read().clone()
            rows[11] = math.nan
            model.adopt(rows, model.count)

    return RunOptions(progress=False, on_begin=runs.append, callback=spoil, **options)


def test_a_run_that_recovers_goes_back_with_half_the_rates_and_says_so(
    toys: Plugins, device: Device, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    again = pipeline(toys, "training.checkpoint_every=8")
    with pytest.raises(GaussianError, match="not finite"):
        start_run(again, spoiling(1, device=device), tmp_path / "ends")
    done = start_run(again, spoiling(2, device=device, recover=True), tmp_path / "recovers")
    assert done.finished
    results = RunFolder(tmp_path / "recovers").results()
    found = [(r["back_to"], r["rates"]) for r in results["recoveries"]]
    assert found == [(16, 0.5), (16, 0.25)]
    assert "not finite after the optimizer's step" in results["recoveries"][0]["error"]
    assert "continuing after iteration 16 with learning rates times 0.25" in caplog.text
    numbers = [line["iteration"] for line in done.metrics]
    assert numbers == sorted(set(numbers))
    # The rates stay low: a run that is stopped later and resumed ends in the same bits.
    options = spoiling(2, device=device, recover=True)

    def stop(done: Any) -> bool | None:
        assert options.callback is not None
        options.callback(done)
        return bool(done.number < 22)

    start_run(again, replace(options, callback=stop), tmp_path / "parts")
    whole = resumed(tmp_path / "parts", toys, device)
    assert whole.hash == done.hash
    assert whole.recoveries == done.recoveries
    usual, _, _ = run(toys, device, tmp_path / "usual")
    assert "recoveries" not in usual.results()
    assert usual.results()["hash"] != done.hash


def test_a_failure_after_a_recovery_is_kept_with_the_bits_of_the_lower_rates(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = pipeline(toys, "training.checkpoint_every=8")
    options = spoiling(1, device=device, recover=True)

    def stop(done: Any) -> bool | None:
        assert options.callback is not None
        options.callback(done)
        return bool(done.number < 22)

    sound = start_run(again, replace(options, callback=stop), tmp_path / "sound")
    loss = ToyTerm.loss

    def fails(self: ToyTerm, step: Step) -> Any:
        if step.iteration == 23:
            raise ZeroDivisionError("late")
        return loss(self, step)

    monkeypatch.setattr(ToyTerm, "loss", fails)
    with pytest.raises(PluginError, match="late"):
        start_run(again, spoiling(1, device=device, recover=True), tmp_path / "fails")
    kept = read_checkpoint(tmp_path / "fails" / "failures" / "iteration-0000023")
    whole = sound.checkpoint()
    assert kept.iteration == whole.iteration == 22
    assert [n for n, t in kept.tensors.items() if not torch.equal(t, whole.tensors[n])] == []
    assert kept.notes["recoveries"] == sound.recoveries


def test_a_run_recovers_five_times(
    toys: Plugins, device: Device, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(GaussianError, match="not finite"):
        start_run(pipeline(toys), spoiling(99, device=device, recover=True), tmp_path / "run")
    assert caplog.text.count("; continuing after iteration 0 with learning rates times") == 5


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
    quiet = RunOptions(device=device, progress=False)
    with pytest.raises(RunError, match="changed: the photograph of view0\n") as caught:
        continue_run(folder.path, quiet, toys)
    assert "--accept-changed-inputs" in caught.value.fix
    assert folder.results()["changed_inputs"] == []
    again = continue_run(folder.path, replace(quiet, accept_changed_inputs=True), toys)
    assert again.finished
    assert folder.results()["changed_inputs"] == ["the photograph of view0"]
    assert load_run(folder.path, plugins=toys, device=device).finished


def test_a_run_without_digests_can_be_opened(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    (folder.path / "inputs.json").unlink()
    assert load_run(folder.path, plugins=toys, device=device).finished


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
    assert load_run(folder.path, plugins=toys, device=device).finished
    folder.pipeline.write_text(text.replace(line, edit))
    with pytest.raises(RunError, match="edited after training began") as caught:
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
    with pytest.raises(RunError, match="belongs to another run"):
        resumed(mine.path, toys, device)


def replace_newest(folder: RunFolder, **changes: Any) -> None:
    """Replace the newest checkpoint by a changed one with valid hashes."""
    place = newest(folder)
    forged = replace(read_checkpoint(place), **changes)
    shutil.rmtree(place)
    write_checkpoint(forged, place)


def test_an_iteration_beyond_the_end_is_refused(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    replace_newest(folder, iteration=1_000_000_000)
    with pytest.raises(RunError, match="of iteration 1000000000, but the run has 30"):
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


def test_errors_for_a_mismatched_state_name_the_checkpoint(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    tensors = read_checkpoint(newest(folder)).tensors
    for name, change in MISFITS.items():
        changed = change(tensors[name])
        rest = {key: value for key, value in tensors.items() if key != name}
        replace_newest(folder, tensors=rest if changed is None else {**rest, name: changed})
        with pytest.raises(ExplainedError) as caught:
            resumed(folder.path, toys, device)
        assert "checkpoint" in caught.value.where, name


def test_a_damaged_checkpoint_falls_back_to_the_previous_one(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run", "training.checkpoint_every=20")
    before = folder.results()
    (newest(folder) / "tensors.safetensors").write_bytes(b"")
    again = resumed(folder.path, toys, device)
    assert again.finished
    assert folder.results()["hash"] == before["hash"]
    assert [line["iteration"] for line in again.metrics] == [30]


def test_a_run_can_be_resumed_before_its_first_iteration(
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
    monkeypatch.setattr(training_run, "AUTOSAVE_SECONDS", 0.0)
    monkeypatch.setattr(training_run, "AUTOSAVE_SHARE", 1e9)
    saved.clear()
    folder, _, _ = run(toys, device, tmp_path / "quick", "training.iterations=3")
    assert saved == [1, 2, 3, 3]
    assert [path.name for path in sorted((folder.path / "checkpoint").iterdir())] == [
        "iteration-0000002",
        "iteration-0000003",
    ]


def test_a_run_in_use_is_not_changed(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    lines = (folder.path / "metrics.jsonl").read_text()
    with folder.locked(), pytest.raises(RunError, match="in use by another process"):
        resumed(folder.path, toys, device)
    assert (folder.path / "metrics.jsonl").read_text() == lines
