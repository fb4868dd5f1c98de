from __future__ import annotations

import json
import logging
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from core_rasterizer import Device, ExplainedError, load_ply
from registry import Fact, PluginError, RunError, Scene, SceneError
from registry.runs.folder import METRICS, RunFolder
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.origin import checkout
from registry.runs.results import RENDERS
from registry.runs.run import Run
from registry.runs.training_run import start_run
from stereogs import Iteration
from tests.host import Plugins, load_pipeline, parse_pipeline
from tests.registry.runs.toy_run import pipeline, resumed, run
from tests.registry.toy_plugin import ToyPoints, ToyPsnr, ToyScene


def test_files_of_a_run(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, finished, output = run(toys, device, tmp_path / "run")
    assert finished
    assert "2 training views, 1 test view" in output
    assert "training  30/30" in output
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
    assert facts["plugins"]["regularizers.toy_term"].startswith("unknown package ?, code ")
    assert facts["command"] == sys.argv
    assert facts["hash_seed"] == os.environ.get("PYTHONHASHSEED")
    assert facts["source"] == checkout()
    # PyPI's file for Linux says 2.13.0, the library in it 2.13.0+cu130.
    assert torch.__version__.startswith(facts["packages"]["torch"])
    lines = [json.loads(x) for x in (folder.path / "metrics.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == [20, 30]
    assert "psnr" in lines[0]["test"]
    assert lines[1]["gaussians"] == results["gaussians"]
    assert {"loss", "photometric", "regularizers.toy_term", "calls"} <= lines[1].keys()
    again = parse_pipeline((folder.path / "pipeline.yaml").read_text(), toys)
    assert again == pipeline(toys)


def test_facts_of_components_do_not_replace_those_of_the_host(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load, initialize = ToyScene.load, ToyPoints.initialize
    facts = (Fact("width", 7), Fact("test", "none"), Fact("paint", 3, affects_scores=False))
    points = {"seconds": -1.0, "tries": 2}

    def with_facts(loader: ToyScene) -> Scene:
        """With a second photograph of half the size."""
        scene = load(loader)
        first, view = scene.train
        image, camera = view.image[::2, ::2].contiguous(), view.camera.resized(16, 12)
        half = replace(view, camera=camera, image=image, depth=None)
        return replace(scene, train=(first, half), facts=facts)

    monkeypatch.setattr(ToyScene, "load", with_facts)
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


def test_evaluations_during_training_change_no_bit(
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


def test_a_slow_metric_is_measured_on_test_views_at_the_end(
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
    """Return the iterations after which test views were scored."""
    lines = map(json.loads, (folder.path / "metrics.jsonl").read_text().splitlines())
    return [line["iteration"] for line in lines if "test" in line]


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


def test_a_name_that_another_training_takes_meanwhile_is_left_to_it(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    names = [tmp_path / "run", tmp_path / "run-2"]

    def out(*given: object) -> Path:
        free = next(path for path in names if not path.exists())
        if free == names[0]:  # the other training creates its folder now
            free.mkdir()
            (free / "its file").touch()
        return free

    options = RunOptions(progress=False, device=device)
    kept = start_run(pipeline(toys), options, out)
    assert [path.name for path in names[0].iterdir()] == ["its file"]
    assert kept.folder is not None
    assert kept.folder.path == names[1]


def test_a_scene_without_test_views(toys: Plugins, device: Device, tmp_path: Path) -> None:
    folder, finished, _ = run(toys, device, tmp_path / "run", "scene.test_views=0")
    assert finished
    results = folder.results()
    assert results["test"] == {}
    assert "psnr" in results["train"]
    drawn = {path.stem for path in (folder.path / "renders").glob("*.png")}
    assert drawn == set(results["scene"]["train"]), "pictures are of training views then"


def test_opening_a_run_loads_the_scene_with_its_settings(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run", "scene.test_views=0")
    opened = load_run(folder.path, plugins=toys, device=device)
    assert opened.scene.test == ()
    assert opened.model.digest() == folder.results()["hash"]


def test_lines_about_photographs_are_printed_by_trainings_only(
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    folder, _, _ = run(toys, device, tmp_path / "run")
    load = ToyScene.load

    def advise(self: ToyScene) -> Any:
        logging.getLogger("toys").warning("photograph more")
        return load(self)

    monkeypatch.setattr(ToyScene, "load", advise)
    load_run(folder.path, plugins=toys, device=device, to_train=False)
    assert "photograph more" not in caplog.text
    load_run(folder.path, plugins=toys, device=device)
    assert "photograph more" in caplog.text


def test_the_demo_pipeline_trains_with_the_installed_plugins(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS", raising=False)
    small = ["scene.width=64", "scene.height=48", "training.iterations=320"]
    chosen = load_pipeline(Path("demo"), Plugins(), overrides=small)
    done = start_run(chosen, RunOptions(device=device, progress=False), tmp_path / "run")
    assert done.finished
    folder = done.folder_or_refuse()
    results = folder.results()
    assert results["train"]["psnr"] > 22
    assert 0 < results["test"]["ssim"] < 1
    assert len(load_ply(folder.path / "exports" / "scene.ply")) == results["gaussians"]


@pytest.mark.parametrize("removed", [True, False])
def test_a_folder_that_disappears_stops_the_run_which_is_kept(
    toys: Plugins, device: Device, tmp_path: Path, removed: bool
) -> None:
    out = tmp_path / "run"

    def disappear(done: Iteration) -> None:
        if done.number == 12 and removed:
            shutil.rmtree(out)
        elif done.number == 12:
            out.rename(tmp_path / "elsewhere")

    text = pipeline(toys, "training.checkpoint_every=5")
    options = RunOptions(device=device, progress=False, callback=disappear)
    with pytest.raises(RunError, match="moved or removed during training") as caught:
        start_run(text, options, out)
    kept = tmp_path / "run-kept-1"
    assert str(kept) in caught.value.what
    assert caught.value.fix == f"stereogs resume {kept}"
    assert not out.exists()
    again = resumed(kept, toys, device)
    assert again.finished
    whole = start_run(text, RunOptions(device=device, progress=False))
    assert again.hash == whole.hash
    lines = (kept / METRICS).read_text().splitlines()
    numbers = [json.loads(line)["iteration"] for line in lines]
    assert numbers == [line["iteration"] for line in whole.metrics]


@pytest.mark.parametrize("removed", [True, False])
def test_a_folder_that_disappears_while_views_are_scored_is_kept(
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    removed: bool,
) -> None:
    out = tmp_path / "run"
    evaluate = Run.evaluate

    def disappear(run: Run, pictures: Path | None = None) -> Any:
        if removed:
            shutil.rmtree(out)
        else:
            out.rename(tmp_path / "elsewhere")
        return evaluate(run, pictures)

    with monkeypatch.context() as patch:
        patch.setattr(Run, "evaluate", disappear)
        with pytest.raises(RunError, match="moved or removed") as caught:
            start_run(pipeline(toys), RunOptions(device=device, progress=False), out)
    kept = tmp_path / "run-kept-1"
    assert caught.value.fix == f"stereogs resume {kept}"
    assert resumed(kept, toys, device).folder_or_refuse().results()["hash"]


def test_a_file_that_cannot_be_written_names_the_run_and_how_to_continue(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    out = tmp_path / "run"

    def begin(_: Run) -> None:
        (out / RENDERS).write_text("in the way")

    options = RunOptions(device=device, progress=False, on_begin=begin)
    with pytest.raises(RunError, match="cannot be written") as caught:
        start_run(pipeline(toys), options, out)
    assert caught.value.where == str(out)
    assert f"`stereogs resume {out}`" in caught.value.fix
    (out / RENDERS).unlink()
    assert resumed(out, toys, device).finished


def test_errors_of_a_callback_are_its_own(toys: Plugins, device: Device, tmp_path: Path) -> None:
    def report(done: Iteration) -> None:
        raise ConnectionRefusedError(111, "Connection refused")

    options = RunOptions(device=device, progress=False, callback=report)
    with pytest.raises(ConnectionRefusedError):
        start_run(pipeline(toys), options, tmp_path / "run")
    assert resumed(tmp_path / "run", toys, device).finished
