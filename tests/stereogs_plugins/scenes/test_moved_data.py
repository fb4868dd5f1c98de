"""A run works from any folder, after its data was moved, and where no photographs are needed without them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import stereogs
from registry import SceneError
from stereogs_plugins.regularizers.parameter_l1 import ParameterL1
from tests.host import main
from tests.stereogs_plugins.scenes.small_scenes import World, write_nerfstudio

PIPELINE = {
    "name": "moved",
    "scene": {"use": "nerfstudio", "path": "data"},
    "initializer": {"use": "random", "count": 200},
    "metrics": ["psnr"],
    "training": {"iterations": 4, "sh_degree": 0},
}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> stereogs.Run:
    """A run of photographs in ./data, stopped after two iterations; the current folder is another."""
    (tmp_path / "project").mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "project")
    write_nerfstudio(Path("data"), World())
    done = stereogs.train(PIPELINE, out="run", callback=lambda i: i.number < 2, progress=False)
    monkeypatch.chdir(tmp_path / "elsewhere")
    return done


def test_it_opens_from_another_folder_also_moved_as_a_whole(run: stereogs.Run) -> None:
    assert len(stereogs.open_run("../project/run").scene.train) == 7
    shutil.move("../project", "../other")
    assert len(stereogs.open_run("../other/run").scene.train) == 7


def test_moved_data_is_found_with_a_folder(run: stereogs.Run) -> None:
    shutil.move("../project/data", "../data")
    with pytest.raises(SceneError) as caught:
        stereogs.open_run("../project/run")
    assert "add `--scene FOLDER`" in caught.value.fix
    folder = Path("../data")
    assert stereogs.open_run("../project/run", scene=folder).scene.train
    resumed = stereogs.resume("../project/run", scene_folder=folder, progress=False)
    assert resumed.finished
    written = Path("../project/run/pipeline.yaml").read_text("utf-8")
    assert "path: data" in written
    assert stereogs.open_run("../project/run", scene=folder).hash == resumed.hash


def test_renders_and_exports_need_no_photographs(run: stereogs.Run) -> None:
    view = run.scene.test[0]
    expected = run.render(view.camera)
    shutil.rmtree("../project/data")
    opened = stereogs.open_run("../project/run", photographs=False)
    again = opened.scene.test[0]
    assert again.name == view.name
    for one, other in zip(opened.render(again.camera), expected, strict=True):
        np.testing.assert_array_equal(one, other)
    for use in (
        lambda: again.image.mean(),
        lambda: view.image - again.image,
        lambda: len(again.image),
        lambda: 255 * again.image,
        lambda: again.image == view.image,
    ):
        with pytest.raises(SceneError):
            use()
    for verb in (["render"], ["export", "--format", "ply"], ["render", "--path", "--frames", "2"]):
        assert main([*verb, "../project/run"]) == 0
    assert main(["eval", "../project/run"]) == 2


def test_a_failed_iteration_is_repeated_from_another_folder_and_with_moved_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(self: ParameterL1, *_: object) -> None:
        raise RuntimeError("on purpose")

    for name in ("project", "elsewhere"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "project")
    write_nerfstudio(Path("data"), World())
    term = {"use": "parameter_l1", "parameter": "opacities"}
    with monkeypatch.context() as patch:
        patch.setattr(ParameterL1, "loss", fail)
        with pytest.raises(stereogs.ExplainedError, match="on purpose"):
            stereogs.train({**PIPELINE, "regularizers": [term]}, out="run", progress=False)
    monkeypatch.chdir(tmp_path / "elsewhere")
    replay = ["replay", "../project/run/failures/iteration-0000001"]
    assert main(replay) == 0
    shutil.move("../project/data", "../data")
    assert main(replay) == 2
    assert main([*replay, "--scene", "../data"]) == 0
    assert "iteration 1 succeeds now" in capsys.readouterr().out
