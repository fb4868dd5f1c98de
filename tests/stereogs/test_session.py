"""The Python API, with files and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import stereogs
from core_rasterizer import Device
from registry import RunError, SceneError
from registry.testing import tiny_scene
from tests.host import PipelineError
from tests.registry.conftest import TOY_ENTRIES, Install

PIPELINE = {
    "name": "toy",
    "initializer": "toy_points",
    "metrics": ["psnr"],
    "exporters": ["toy_files"],
    "training": {"iterations": 12, "sh_degree": 0},
}


@pytest.fixture(autouse=True)
def _toys(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The toy plugin is installed; the working folder is empty."""
    install("toys", "1.5", TOY_ENTRIES)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


def train(**more: object) -> stereogs.Run:
    return stereogs.train(PIPELINE, scene=tiny_scene(), progress=False, **more)  # type: ignore[arg-type]


def test_without_files(capsys: pytest.CaptureFixture[str]) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run = train()
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert run.finished
    assert list(Path().iterdir()) == []
    assert capsys.readouterr().out == ""
    view = run.scene.test[0]
    picture = run.render(view.camera)
    assert [a.shape for a in picture] == [(24, 32, 3), (24, 32), (24, 32)]
    assert all(a.dtype == np.float32 for a in picture)
    error = float(((picture.rgb.astype(np.float64) - view.image.double().numpy()) ** 2).mean())
    assert run.scores["test"].mean["psnr"] == pytest.approx(-10 * np.log10(error), abs=1e-4)
    alone = stereogs.render(run.model, view.camera, background=run.scene.background)
    assert np.array_equal(alone.rgb, picture.rgb)
    assert run.metrics[-1]["iteration"] == 12


def test_a_time_limit_keeps_all_iterations_that_fit() -> None:
    run = train(fit=stereogs.within(600))
    assert run.finished
    assert run.iteration == 12
    assert run.pipeline.training.evaluate_every == 0, "chosen for a time"
    assert run.hash == train().hash
    assert train(fit=stereogs.within(1e-3)).iteration == 12, "fewer than the least"


def test_saving_later_writes_the_same_files_as_training_into_a_folder() -> None:
    early = train(out="early")
    late = train()
    late.save("late")
    assert early.hash == late.hash
    names = [
        sorted(
            str(file.relative_to(folder))
            for file in Path(folder).rglob("*")
            if "iteration-0000000" not in file.parts
        )
        for folder in ("early", "late")
    ]
    assert names[0] == names[1]
    first, second = stereogs.results("early"), stereogs.results("late")
    assert first.keys() == second.keys()
    for key in ("hash", "test", "views", "scene", "initialization"):
        if key != "initialization":
            assert first[key] == second[key]
    with pytest.raises(RunError, match="has a folder already"):
        late.save("again")


def test_a_run_is_opened_and_exported() -> None:
    scene, run = tiny_scene(), train(out="run")
    again = stereogs.open_run("run", scene=scene)
    assert again.finished
    assert again.hash == run.hash
    assert again.scores["test"].mean == run.scores["test"].mean
    exported = again.export("points.ply")
    assert exported.stat().st_size > 1000
    with pytest.raises(SceneError, match="made in Python") as caught:
        stereogs.open_run("run")
    assert "scene=" in caught.value.fix
    with pytest.raises(RunError, match="not a run folder"):
        stereogs.open_run("nothing")


def test_the_callback_stops_training_and_resume_continues() -> None:
    seen = []

    def until_five(done: stereogs.Iteration) -> bool:
        seen.append(done.number)
        return done.number < 5

    run = train(out="run", callback=until_five)
    assert seen == [1, 2, 3, 4, 5]
    assert not run.finished
    assert stereogs.results("run") == {}
    resumed = stereogs.resume("run", scene=tiny_scene(), progress=False)
    assert resumed.finished
    assert resumed.hash == train().hash


def test_a_pipeline_from_values_text_and_file(tmp_path: Path) -> None:
    text = "name: toy\nscene: toy_scene\ninitializer: toy_points\n"
    file = tmp_path / "toy.yaml"
    file.write_text(text)
    values = {"name": "toy", "scene": {"use": "toy_scene"}, "initializer": "toy_points"}
    change = ["training.iterations=3"]
    one, two, three = (stereogs.build_pipeline(source, change) for source in (values, text, file))
    assert one == two == three
    assert one.training.iterations == 3
    assert stereogs.build_pipeline(str(file), change) == one
    assert stereogs.load_scene(one).name == stereogs.load_scene(file).name == "tiny"
    assert stereogs.load_scene(text, ["test_views=0"]).test == ()
    with pytest.raises(PipelineError, match="already built"):
        stereogs.load_scene(one, ["test_views=0"])
    with pytest.raises(PipelineError, match="plain values"):
        stereogs.build_pipeline({**values, "training": {"seed": object()}})
    with pytest.raises(PipelineError, match="did you mean 'initializer'"):
        stereogs.build_pipeline({"name": "x", "initialiser": "toy_points"})


def test_a_given_scene_is_recorded_in_the_pipeline() -> None:
    values = {**PIPELINE, "scene": {"use": "toy_scene", "mode": "crash"}}
    run = stereogs.train(values, scene=tiny_scene(), progress=False, out="run")
    assert run.pipeline.one("scene").offer.name == "in_memory"
    assert "use: in_memory" in Path("run/pipeline.yaml").read_text()
    with pytest.raises(SceneError, match="does not name a scene"):
        stereogs.train(PIPELINE)


def test_a_pipeline_can_train_on_a_given_scene() -> None:
    text = "name: x\nscene: {use: toy_scene, path: '${NOWHERE}'}\ninitializer: toy_points\n"
    pipeline = stereogs.build_pipeline(text, ["scene=in_memory", "training.iterations=2"])
    assert stereogs.train(pipeline, scene=tiny_scene(), progress=False).finished


def test_a_protocol_does_not_apply_to_a_given_scene() -> None:
    pipeline = stereogs.build_pipeline({**PIPELINE, "metrics": []})
    from dataclasses import replace

    from tests.host import AppliedProtocol, load_protocol

    claimed = replace(pipeline, protocol=AppliedProtocol(load_protocol("llff-3"), {}))
    with pytest.raises(SceneError, match="'llff-3' does not apply"):
        stereogs.train(claimed, scene=tiny_scene())


def test_a_scene_from_arrays(device: Device) -> None:
    cameras = [
        stereogs.Camera.look_at((x, 0, 0), (0, 0, 3), 30.0, 32, 24) for x in (-0.3, 0.0, 0.3)
    ]
    bytes_, floats = np.full((24, 32, 3), 51, np.uint8), np.full((24, 32, 3), 0.2)
    left = np.arange(32) < 16
    weights = [None, np.broadcast_to(left, (24, 32)), 0.25]
    scene = stereogs.scene_from_arrays(
        [bytes_, floats, bytes_], cameras, bounds=(1.0, 5.0), test=[1], weights=weights
    )
    assert scene.train[0].weights is None
    assert scene.train[1].weights is not None
    assert torch.equal(scene.train[1].weights, torch.full((24, 32), 0.25))
    assert scene.test[0].weights is not None
    assert scene.test[0].weights.sum() == 24 * 16
    with pytest.raises(SceneError, match="3 images and 1 weights"):
        stereogs.scene_from_arrays([bytes_] * 3, cameras, bounds=(1.0, 5.0), weights=[None])
    assert [view.name for view in scene.train] == ["view_000", "view_002"]
    assert [view.name for view in scene.test] == ["view_001"]
    assert torch.allclose(scene.train[0].image, scene.test[0].image)
    with pytest.raises(SceneError, match="3 images and 2 cameras"):
        stereogs.scene_from_arrays([bytes_] * 3, cameras[:2], bounds=(1.0, 5.0))
    with pytest.raises(SceneError, match="has the index 3"):
        stereogs.scene_from_arrays([bytes_] * 3, cameras, bounds=(1.0, 5.0), test=[3])
    with pytest.raises(SceneError, match="outside"):
        stereogs.scene_from_arrays([floats * 6] * 3, cameras, bounds=(1.0, 5.0))
    with pytest.raises(SceneError, match="shape"):
        stereogs.scene_from_arrays([floats[:5]] * 3, cameras, bounds=(1.0, 5.0))
