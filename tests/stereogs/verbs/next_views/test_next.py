"""`stereogs next` and `stereogs.next_views`, on a run of the procedural room."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from PIL import Image

import stereogs
from registry import RunError, SceneError
from stereogs import Run
from stereogs.verbs.next_views import next_views
from stereogs.verbs.next_views.given import other_pictures, read_poses
from tests.host import SELECTION, main, suggested_cameras

PIPELINE = """\
name: tiny
scene: {use: procedural, width: 96, height: 72, train_views: 3, test_views: 4, points: 1500}
initializer: {use: sfm}
metrics: [psnr]
reports: [html]
training: {iterations: 30}
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Run:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(SELECTION, raising=False)
        folder = tmp_path_factory.mktemp("next") / "run"
        return stereogs.train(PIPELINE, out=folder, progress=False)


@pytest.fixture
def run(trained: Run, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The run, and all installed plugins."""
    monkeypatch.delenv(SELECTION, raising=False)
    return trained


def test_the_suggestions_are_apart_from_photographs_and_from_each_other(run: Run) -> None:
    found = next_views(run)
    assert [one.gain for one in found] == sorted((one.gain for one in found), reverse=True)
    assert 0 < sum(one.gain for one in found) < 1
    centers = [view.camera.center for view in run.scene.train] + [o.camera.center for o in found]
    apart = torch.cdist(torch.stack(centers), torch.stack(centers)).fill_diagonal_(1e9)
    assert float(apart.min()) > 0.05
    assert all(one.overlap > 0.3 for one in found)


def test_of_given_cameras_a_new_place_is_chosen_before_one_that_was_photographed(run: Run) -> None:
    existing = [view.camera for view in run.scene.train]
    candidates = [*existing, *(view.camera for view in run.scene.test)]
    (best,) = next_views(run, candidates, count=1)
    assert best.index >= len(existing)
    assert len(next_views(run, candidates, count=99)) == len(candidates)


def test_the_command_writes_pictures_poses_and_the_page(
    run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run.folder_or_refuse().path
    assert main(["next", str(folder), "--count", "2"]) == 0
    printed = capsys.readouterr().out
    listed = json.loads((folder / "next" / "next.json").read_text("utf-8"))["frames"]
    first, second = (frame["words"] for frame in listed)
    assert f"1  {first}\n" in printed
    assert f"2  {second}\n" in printed
    assert sorted(file.name for file in (folder / "next").iterdir()) == [
        "1.png",
        "2.png",
        "next.json",
    ]
    with Image.open(folder / "next" / "1.png") as picture:
        assert picture.size == (96, 72)
    page = (folder / "report.html").read_text("utf-8")
    assert f"1: {first.split(';')[0]}" in page
    setup = json.loads(page.split('id="scene-setup">')[1].split("</script>")[0])
    assert len(setup["views"]) == 3 + 4 + 2
    assert len(suggested_cameras(folder, run.iteration)) == 2
    assert suggested_cameras(folder, run.iteration + 1) == {}, "it is about another state"

    _, cameras = read_poses(folder / "next" / "next.json", run.scene.train[0].camera)
    for camera, one in zip(cameras, next_views(run, count=2), strict=True):
        torch.testing.assert_close(camera.world_to_camera, one.camera.world_to_camera)


def test_pictures_that_the_run_did_not_train_on_are_named(run: Run) -> None:
    names, cameras = other_pictures(run, [])
    assert names == [view.name for view in run.scene.test]
    assert cameras == [view.camera for view in run.scene.test]


def test_settings_that_move_the_cameras_are_refused(run: Run) -> None:
    with pytest.raises(RunError, match="is elsewhere than in the run"):
        other_pictures(run, ["train_views=6"])


def test_a_file_without_poses_says_what_to_write(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "poses.json"
    file.write_text('{"frames": []}')
    with pytest.raises(SceneError) as caught:
        read_poses(file, run.scene.train[0].camera)
    assert caught.value.fix is not None
    assert "transform_matrix" in caught.value.fix
