"""Observers are notified of a run, and no result depends on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import registry as r
from core_rasterizer import Device, ExplainedError
from registry import PluginError
from registry.events import IterationDone, ViewsScored
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from stereogs import Pipeline
from tests.host import HOOK_POINTS, HostSettings, Item, Offer, Place, Plugins, parse_pipeline
from tests.registry.conftest import TOYS
from tests.registry.toy_plugin import ToyDiary

TEXT = """\
name: toy
scene: toy_scene
initializer: toy_points
regularizers: [{use: toy_term, weight: 0.1}]
densification: {use: toy_growth, every: 2, stop: 4}
metrics: [psnr]
training: {iterations: 6, sh_degree: 0, evaluate_every: 4, checkpoint_every: 2}
"""
WATCHED = TEXT + "observers: [{use: toy_diary, every: 3}]\n"


def trained(text: str, toys: Plugins, device: Device, out: Path | None, **more: Any) -> Run:
    pipeline = parse_pipeline(text, toys, source="p.yaml")
    return start_run(pipeline, RunOptions(device=device, progress=False, **more), out)


def resumed(out: Path, toys: Plugins, device: Device) -> Run:
    return continue_run(out, RunOptions(device=device, progress=False), toys)


def diary(out: Path) -> list[str]:
    return (out / "observers/toy_diary/diary.txt").read_text().splitlines()


def failing(when: str) -> str:
    return WATCHED.replace("every: 3", f"every: 3, fault: {when}")


@pytest.fixture(scope="module")
def alone(device: Device) -> Run:
    """A run without observers."""
    return trained(TEXT, Plugins(TOYS), device, None)


def test_observers_are_notified_in_order_and_change_no_bit(
    toys: Plugins, device: Device, tmp_path: Path, alone: Run
) -> None:
    run = trained(WATCHED, toys, device, tmp_path / "run")
    assert run.hash == alone.hash
    assert run.scores["test"].views == alone.scores["test"].views
    assert "observers" not in alone.pipeline_text
    told = diary(tmp_path / "run")
    assert [line.partition(" ")[0] for line in told] == [
        *("started", "iterated", "evaluated", "iterated", "evaluated", "ended")
    ]
    assert told[0] == "started run 0 False 6"
    assert told[1].split()[:2] == ["iterated", "3"]
    assert told[3].split() == [
        *("iterated", "6", str(run.model.count), "photometric", "calls", "regularizers.toy_term")
    ]
    assert (told[2], told[4]) == ("evaluated 4 test", "evaluated 6 test train")
    assert told[5] == "ended 6 True True None"


class Recorder(r.Observer):
    """Keeps all events."""

    def __init__(self, settings: r.Settings, context: r.Context) -> None:
        super().__init__(settings, context)
        self.told: list[Any] = []
        self.started = self.iterated = self.evaluated = self.ended = self.told.append  # type: ignore[method-assign, assignment]


def recorded(pipeline: Pipeline, device: Device, out: Path | None) -> tuple[Run, list[Any]]:
    point = next(point for point in HOOK_POINTS if point.base is r.Observer)
    offer = Offer(point, "recorder", Recorder, "recorder", "tests", "0")
    item = Item(
        "recorder", r.Settings(), HostSettings(use="recorder", every=4), offer, Place("here")
    )
    pipeline.items["observers"] = (item,)
    run = start_run(pipeline, RunOptions(device=device, progress=False), out)
    return run, run.parts["observers"][0].component.told


def test_contents_of_events(toys: Plugins, device: Device, tmp_path: Path) -> None:
    run, told = recorded(parse_pipeline(TEXT, toys), device, tmp_path / "run")
    begun, iteration, _, final, ended = told
    assert begun.folder == tmp_path / "run/observers/recorder"
    assert begun.pipeline["training"]["iterations"] == 6
    assert begun.pipeline["observers"][0]["every"] == 4
    assert begun.facts["scene"]["test"] == ["view1"]
    assert [view.name for view in begun.scene.train] == ["view0", "view2"]
    with pytest.raises(PluginError, match="test"):
        _ = begun.scene.test
    with pytest.raises(PluginError, match="depth"):
        _ = begun.scene.train[0].depth
    assert iteration.iteration == 4
    assert 0 < iteration.seconds <= run.seconds.training
    assert iteration.loss > iteration.numbers["photometric"] > 0
    assert iteration.learning_rates["means"] > 0
    assert iteration.view.name in ("view0", "view2")
    assert iteration.rendering.rgb.shape == iteration.view.image.shape
    assert not iteration.rendering.rgb.requires_grad
    assert iteration.model.count == run.model.count
    assert final.mean == {split: run.scores[split].mean for split in ("test", "train")}
    assert final.views["test"]["view1"] == run.scores["test"].views["view1"]
    assert ended.results["hash"] == run.hash


def test_a_run_in_memory_leaves_no_file(toys: Plugins, device: Device, alone: Run) -> None:
    run, told = recorded(parse_pipeline(TEXT, toys), device, None)
    assert (told[0].folder, told[0].title) == (None, "toy")
    assert (told[-1].finished, told[-1].results) == (True, None)
    assert run.hash == alone.hash


def test_observers_receive_the_first_of_several_fields(toys: Plugins, device: Device) -> None:
    text = TEXT.replace("iterations: 6", "iterations: 6, fields: 2")
    run, told = recorded(parse_pipeline(text, toys), device, None)
    (iteration,) = [event for event in told if isinstance(event, IterationDone)]
    assert iteration.gaussians == run.model.count
    assert {"photometric", "field1/photometric"} <= iteration.numbers.keys()


@pytest.mark.parametrize("when", ["started", "iterated", "evaluated", "ended", "draws"])
def test_an_observer_that_fails_ends_the_run_and_is_named(
    toys: Plugins, device: Device, tmp_path: Path, when: str
) -> None:
    out = tmp_path / "run"
    with pytest.raises(ExplainedError) as caught:
        trained(failing(when), toys, device, out)
    error = caught.value
    iteration = ", iteration 3" if when in ("iterated", "draws") else ""
    assert error.where == f"observer 'toy_diary' (unknown package ?) at p.yaml:8{iteration}"
    assert "--disable toy_diary" in error.fix or when == "draws"
    reached = {"started": 0, "evaluated": 2, "ended": 6}.get(when, 2)
    assert load_run(out, plugins=toys, device=device).iteration == reached
    assert ((out / "results.json").is_file()) == (when == "ended")
    assert not (out / "failures").exists(), "training itself did not fail"
    told = [line for line in diary(out) if line.startswith("ended")]
    assert len(told) == (0 if when == "started" else 1)
    if when not in ("started", "ended"):
        assert "None" not in told[0]


def test_an_observer_writes_into_copies(toys: Plugins, device: Device, alone: Run) -> None:
    assert trained(failing("writes"), toys, device, None).hash == alone.hash


def test_observers_receive_the_error_and_a_second_error_is_logged(
    toys: Plugins, device: Device, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = failing("ended").replace("weight: 0.1", "fault: crash, start: 3")
    with pytest.raises(PluginError, match="regularizer 'toy_term' failed"):
        trained(text, toys, device, tmp_path / "run")
    end = "\n".join(diary(tmp_path / "run")).partition("ended ")[2]
    assert end.startswith("2 False False ")
    assert "the regularizer 'toy_term' failed: ZeroDivisionError: boom" in end
    assert "boom in ended" in caplog.text


def test_a_resumed_run_notifies_observers_of_its_iteration(
    toys: Plugins, device: Device, tmp_path: Path, alone: Run
) -> None:
    out = tmp_path / "run"
    run = trained(WATCHED, toys, device, out, callback=lambda done: done.number < 4)
    assert not run.finished
    assert diary(out)[-1] == "ended 4 False False None"
    assert resumed(out, toys, device).hash == alone.hash
    told = diary(out)[4:]
    assert told[0] == "started run 4 True 6"
    assert [line.split()[:2] for line in told[1:]] == [
        ["iterated", "6"],
        ["evaluated", "6"],
        ["ended", "6"],
    ]


def test_a_run_can_be_resumed_without_its_observer(
    toys: Plugins, device: Device, tmp_path: Path, alone: Run
) -> None:
    out = tmp_path / "run"
    with pytest.raises(PluginError, match="boom"):
        trained(failing("iterated"), toys, device, out)
    file = out / "pipeline.yaml"
    text = file.read_text()
    file.write_text(text.partition("observers:")[0] + "training:" + text.partition("training:")[2])
    assert resumed(out, toys, device).hash == alone.hash


def test_a_run_can_be_resumed_with_a_new_observer(
    toys: Plugins, device: Device, tmp_path: Path, alone: Run
) -> None:
    trained(TEXT, toys, device, tmp_path, callback=lambda done: done.number < 4)
    with (tmp_path / "pipeline.yaml").open("a") as added:
        added.write("observers: [toy_diary]\n")
    assert resumed(tmp_path, toys, device).hash == alone.hash
    assert diary(tmp_path)[0].endswith(" 4 True 6")


def test_observers_receive_copies(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoil(self: ToyDiary, scored: ViewsScored) -> None:
        for split in scored.views.values():
            for row in split.values():
                row.clear()  # type: ignore[attr-defined]

    monkeypatch.setattr(ToyDiary, "evaluated", spoil)
    run = trained(WATCHED, toys, device, tmp_path / "run")
    assert run.scores["test"].views["view1"].keys() == {"psnr"}


def test_an_observer_may_keep_a_thread_until_the_end(
    toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    import threading

    done = threading.Event()
    worker = threading.Thread(target=done.wait)
    monkeypatch.setattr(ToyDiary, "started", lambda self, run: worker.start())
    monkeypatch.setattr(ToyDiary, "iterated", lambda self, told: None)
    monkeypatch.setattr(ToyDiary, "evaluated", lambda self, scored: None)
    monkeypatch.setattr(ToyDiary, "ended", lambda self, run: done.set())
    assert trained(WATCHED, toys, device, None).finished
    worker.join(5)
    assert "thread" not in caplog.text
