"""The end of a run: failures there are recorded, and do not affect other results."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console

from core_rasterizer import Device
from registry import RunError, Scene, SceneError, Unavailable
from registry.runs.folder import RunFolder
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.outputs import renew
from registry.runs.results import read_results, score_of
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from stereogs_plugins.reports.html import HtmlReport
from tests.host import FAILED, Plugins, conclude, parse_pipeline, read_checkpoint, write_checkpoint
from tests.registry.toy_plugin import ToyExporter, ToyPoints, ToyPsnr, ToyReport, ToyScene
from tests.stereogs_plugins.building import build

TEXT = """\
name: toy
scene: toy_scene
initializer: toy_points
metrics: [psnr]
exporters: [toy_files]
reports: [toy_report]
training: {iterations: 2, sh_degree: 0}
"""


@pytest.fixture
def train(toys: Plugins, device: Device, tmp_path: Path) -> Callable[[], Run]:
    """Return a function that trains a short run into a folder."""

    def train() -> Run:
        pipeline = parse_pipeline(TEXT, toys, source="toy.yaml")
        return start_run(pipeline, RunOptions(device=device, progress=False), tmp_path / "run")

    return train


def quiet() -> Console:
    return Console(file=io.StringIO())


def boom(self: object, *arguments: object) -> Any:
    raise ZeroDivisionError("boom")


NONSENSE: dict[str, tuple[type, str, Any, str, str]] = {
    "a metric fails": (ToyPsnr, "measure", boom, "metrics.psnr", "boom"),
    "an exporter fails": (ToyExporter, "export", boom, "exporters.toy_files", "boom"),
    "a report fails": (ToyReport, "write", boom, "reports.toy_report", "boom"),
    "no answer": (ToyExporter, "export", lambda *_: None, "exporters.toy_files", "is None"),
    "names, not paths": (ToyReport, "write", lambda *_: ["a"], "reports.toy_report", "of paths"),
    "no such file": (
        ToyExporter,
        "export",
        lambda self, model, scene, folder: [folder / "scene.ply"],
        "exporters.toy_files",
        "no such file",
    ),
    "it writes the model": (
        ToyExporter,
        "export",
        lambda self, model, scene, folder: model.write("means", torch.zeros(model.count, 3)),
        "exporters.toy_files",
        "no attribute 'write'",
    ),
}


@pytest.mark.parametrize("fault", NONSENSE.values(), ids=list(NONSENSE))
def test_failures_after_training_are_recorded_and_other_results_kept(
    train: Callable[[], Run],
    toys: Plugins,
    device: Device,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fault: tuple[type, str, Any, str, str],
) -> None:
    component, method, broken, name, what = fault
    with monkeypatch.context() as patch:
        patch.setattr(component, method, broken)
        run = train()
    folder = run.folder_or_refuse()
    results = folder.results()
    assert results["hash"] == run.hash
    (failure,) = results["failures"]
    assert failure["component"] == name
    assert what in failure["what"]
    assert "toy.yaml:" in failure["where"]
    assert results["exports"] == ([] if component is ToyExporter else ["exports/count.txt"])
    assert results["reports"] == ([] if component is ToyReport else ["report.txt"])
    assert (results["test"]["psnr"] is None) == (component is ToyPsnr)
    assert ("psnr" in results["unavailable"]) == (component is ToyPsnr)
    assert conclude(run, quiet()) == FAILED
    said = capsys.readouterr().err
    assert f"stereogs: {name}: " in said
    assert f"stereogs eval {folder.path}" in said.replace("\n", "")
    mended = renew(load_run(folder.path, plugins=toys, device=device), folder)
    assert mended["failures"] == []
    assert (mended["exports"], mended["reports"]) == (["exports/count.txt"], ["report.txt"])
    assert mended["test"]["psnr"] > 0
    assert mended["seconds"] == results["seconds"]
    assert conclude(run, quiet()) == 0


def test_an_infinite_score_is_null_and_its_views_are_listed(
    train: Callable[[], Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ToyPsnr, "measure", lambda *_: float("inf"))
    results = train().folder_or_refuse().results()
    assert results["test"] == {"psnr": None}
    assert results["infinite"] == {
        "test": {"psnr": ["view1"]},
        "train": {"psnr": ["view0", "view2"]},
    }
    assert results["failures"] == []


def test_of_many_training_views_evenly_spaced_ones_are_scored(
    train: Callable[[], Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    load = ToyScene.load

    def many(self: ToyScene) -> Scene:
        scene = load(self)
        view, count = scene.train[0], 96
        cameras = [view.camera.shifted_right(0.001 * k) for k in range(count)]
        views = [replace(view, name=f"{k:02}", camera=cameras[k]) for k in range(count)]
        return replace(scene, train=tuple(views))

    monkeypatch.setattr(ToyScene, "load", many)
    run = train()
    path = run.folder_or_refuse().path / "results.json"
    results = read_results(path)
    assert results["train_scored"] == 48
    assert list(results["views"]["train"]) == [f"{k:02}" for k in range(0, 96, 2)]
    said = io.StringIO()
    assert conclude(run, Console(file=said)) == 0
    assert "train mean of 48" in said.getvalue()
    (page,) = build(HtmlReport).write(path.parent, run.scene)
    assert "training photographs (48 of 96, evenly spaced)" in page.read_text("utf-8")
    path.write_text(json.dumps({**results, "train_scored": 0}), "utf-8")
    with pytest.raises(RunError, match=r"views\.train are not the scene's"):
        read_results(path)


def test_a_score_may_be_missing_in_one_view_and_infinite_in_another(
    train: Callable[[], Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = {"view0": Unavailable("no depth"), "view1": float("inf"), "view2": 2.0}
    monkeypatch.setattr(ToyPsnr, "measure_view", lambda self, _, view, scene: answers[view.name])
    run = train()
    results = run.folder_or_refuse().results()
    assert (results["test"], results["train"]) == ({"psnr": None}, {"psnr": 2.0})
    assert results["views"]["train"] == {"view0": {"psnr": None}, "view2": {"psnr": 2.0}}
    assert (
        score_of(results, "test", "psnr") == score_of(results, "test", "psnr", "view1") == math.inf
    )
    assert score_of(results, "train", "psnr", "view0") is None
    assert score_of(results, "train", "psnr", "view2") == score_of(results, "train", "psnr") == 2
    conclude(run, Console(file=(shown := io.StringIO()), width=80))
    assert any("view1" in line and "inf" in line for line in shown.getvalue().splitlines())


def other_gaussians(folder: RunFolder) -> None:
    """Replace the newest checkpoint by an intact one with other Gaussians."""
    place = max((folder.path / "checkpoint").iterdir())
    checkpoint = read_checkpoint(place)
    checkpoint.tensors["model/means"] = checkpoint.tensors["model/means"] + 1
    place.rename(folder.path / "aside")
    write_checkpoint(checkpoint, place)


def test_eval_refuses_gaussians_that_were_not_scored(
    train: Callable[[], Run], toys: Plugins, device: Device
) -> None:
    folder = train().folder_or_refuse()
    before = (folder.path / "results.json").read_text()
    other_gaussians(folder)
    with pytest.raises(RunError, match="not those that results"):
        load_run(folder.path, plugins=toys, device=device)
    assert (folder.path / "results.json").read_text() == before


def test_eval_without_results_knows_what_the_folder_knows(
    train: Callable[[], Run], toys: Plugins, device: Device
) -> None:
    folder = train().folder_or_refuse()
    before = folder.results()
    (folder.path / "results.json").unlink()
    after = renew(load_run(folder.path, plugins=toys, device=device), folder)
    assert after["initialization"] == before["initialization"]
    assert after["seconds"] == before["seconds"] > 0
    assert after["stages"]["initialization"] == before["stages"]["initialization"]
    assert after["iterations_per_second"] > 0


def test_eval_refuses_a_checkpoint_older_than_the_results(
    train: Callable[[], Run], toys: Plugins, device: Device
) -> None:
    folder = train().folder_or_refuse()
    before = folder.results()
    (max((folder.path / "checkpoint").iterdir()) / "manifest.json").unlink()
    run = load_run(folder.path, plugins=toys, device=device)
    assert run.iteration == 0
    with pytest.raises(
        RunError, match="of iteration 2, the newest intact checkpoint of 0"
    ) as caught:
        renew(run, folder)
    assert "stereogs resume" in caught.value.fix
    assert folder.results() == before
    options = RunOptions(device=device, progress=False)
    assert continue_run(folder.path, options, toys).finished
    assert folder.results()["hash"] == before["hash"]


@pytest.mark.parametrize(("iteration", "reported"), [(1, False), (2, True)])
def test_another_hash_is_reported_only_of_the_same_iteration(
    train: Callable[[], Run],
    toys: Plugins,
    device: Device,
    caplog: pytest.LogCaptureFixture,
    iteration: int,
    reported: bool,
) -> None:
    folder = train().folder_or_refuse()
    (max((folder.path / "checkpoint").iterdir()) / "manifest.json").unlink()
    changed = {**folder.results(), "iterations": iteration, "hash": "f" * 64}
    (folder.path / "results.json").write_text(json.dumps(changed))
    continue_run(folder.path, RunOptions(device=device, progress=False), toys)
    assert ("when the run was finished before" in caplog.text) == reported


@pytest.mark.parametrize("name", ["../../evil", "a/b", "", "..", "a\nb", "c\\d"])
def test_a_picture_outside_the_run_folder_is_refused(
    train: Callable[[], Run], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    initialize = ToyPoints.initialize

    def drawing(self: ToyPoints, *arguments: Any) -> Any:
        points = initialize(self, *arguments)
        points.__dict__["pictures"] = {name: torch.zeros(2, 2, 3)}
        return points

    monkeypatch.setattr(ToyPoints, "initialize", drawing)
    with pytest.raises(SceneError, match="no plain file name") as caught:
        train()
    assert "initializer 'toy_points'" in caught.value.where
    assert list(tmp_path.iterdir()) == []
