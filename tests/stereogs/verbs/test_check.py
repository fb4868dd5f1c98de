"""`stereogs check`: facts, warnings, the guess of a format, and the picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import Camera, ExplainedError
from registry import PointCloud, SceneError
from registry.testing import tiny_scene
from stereogs.verbs.check.facts import facts
from stereogs.verbs.check.scene_picture import (
    TEST_COLOR,
    TRAIN_COLOR,
    WIDTH,
    make_plan,
    scene_picture,
)
from tests.host import Plugins, main, parse_command, recognize
from tests.registry.conftest import TOY_ENTRIES, Install
from tests.registry.training.test_scene_facts import camera, scene_of, wall

Capture = pytest.CaptureFixture[str]
LOADERS = '''
from dataclasses import replace
from pathlib import Path

import registry
from registry.testing import tiny_scene


class Settings(registry.Settings):
    path: Path
    title: str = "untitled"


class Marked(registry.SceneLoader[Settings]):
    """Reads folders that hold MARKER."""

    recognized_by = "MARKER"

    @classmethod
    def recognizes(cls, folder):
        return (folder / cls.recognized_by).is_file()

    def load(self):
        if not self.settings.path.is_dir():
            raise registry.SceneError("no such folder", where=str(self.settings.path))
        return replace(tiny_scene(), name=self.settings.title, facts=(registry.Fact("changed", "nothing"),))


class AlsoMarked(Marked):
    recognized_by = "OTHER"


@registry.hookimpl
def stereogs_register_scenes(register):
    register("marked", Marked)
    register("also_marked", AlsoMarked)
'''


@pytest.fixture
def folder(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that the loader `marked` recognizes, in an otherwise empty working folder."""
    entries = {"marked": "loaders_module", "also_marked": "loaders_module"}
    install("loaders", "1.0", entries, loaders_module=LOADERS)
    folder = tmp_path / "work" / "data${x}"
    folder.mkdir(parents=True)
    (folder / "MARKER").touch()
    monkeypatch.chdir(folder.parent)
    return folder


def test_a_folder_is_read_by_the_loader_that_knows_it(folder: Path, capsys: Capture) -> None:
    assert main(["check", folder.name, "--set", "title=attic"]) == 0
    output = capsys.readouterr().out
    for text in (
        "attic, read by the scene loader marked",
        "train   2 views: view0, view2",
        "test    1 view: ",
        "check.png",
    ):
        assert text in output
    assert "changed" not in output, "only with --details"
    assert output.splitlines()[-2:] == [
        "3 photographs with cameras; ready, with 1 warning:",
        "  stereogs train 'data${x}' --set scene.title=attic",
    ]
    with Image.open("check.png") as picture:
        assert picture.width == WIDTH


def test_settings_may_be_named_as_in_a_pipeline(folder: Path, capsys: Capture) -> None:
    arguments = ["--format", "also_marked", "--set", "scene.title=attic", "--out", "other.png"]
    assert main(["check", folder.name, *arguments, "--details"]) == 0
    output = capsys.readouterr().out
    assert "attic, read by the scene loader also_marked" in output
    assert "  changed     nothing" in output.splitlines()
    assert output.endswith("--set scene.use=also_marked --set scene.title=attic\n")
    assert Path("other.png").is_file()


def test_the_scene_of_a_pipeline(install: Install, tmp_path: Path, capsys: Capture) -> None:
    install("toys", "1.5", TOY_ENTRIES)
    pipeline, out = tmp_path / "toy.yaml", str(tmp_path / "check.png")
    pipeline.write_text("name: toy\nscene: toy_scene\ninitializer: toy_points\n")
    assert main(["check", str(pipeline), "--set", "test_views=0", "--out", out]) == 0
    output = capsys.readouterr().out
    assert "read by the scene loader toy_scene" in output
    assert "train   2 views" in output
    assert "test    none" in output


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["nowhere"], "no such folder of data"),
        (["nowhere.yaml"], "cannot be read"),
        (["nowhere", "--format", "marked"], "no such folder"),
        (["data${x}", "--format", "markd"], "did you mean 'marked'"),
        (["data${x}", "--set", "titel=x"], "did you mean 'title'"),
        (["data${x}", "--set", "title"], "must look like"),
        (["data${x}", "--out", "x.jpg"], ".png file"),
        (["data${x}", "--out", "none/x.png"], "existing folder"),
        (["x.yaml", "--format", "marked"], "names its own loader"),
    ],
)
def test_mistakes_are_explained_and_leave_no_picture(
    folder: Path, capsys: Capture, arguments: list[str], what: str
) -> None:
    assert main(["check", *arguments]) == 2
    captured = capsys.readouterr().err
    assert what in captured
    assert "Traceback" not in captured
    assert [path.name for path in Path().iterdir()] == [folder.name]


def test_an_unknown_folder_lists_the_formats_that_were_tried(folder: Path) -> None:
    (folder / "MARKER").unlink()
    with pytest.raises(SceneError) as caught:
        recognize(folder, Plugins())
    assert "marked: MARKER" in caught.value.what
    assert "also_marked: OTHER" in caught.value.what


def test_loaders_that_fail_to_load_are_named(install: Install, tmp_path: Path) -> None:
    install("broken", "1.0", {"broken": "broken_module"}, broken_module="import nowhere_at_all")
    with pytest.raises(SceneError, match="nowhere_at_all"):
        recognize(tmp_path, Plugins())


def test_a_folder_of_two_formats_is_ambiguous(folder: Path) -> None:
    (folder / "OTHER").touch()
    with pytest.raises(SceneError, match="several formats: also_marked, marked"):
        recognize(folder, Plugins())


def test_a_loader_that_recognizes_no_folder_is_never_chosen(toys: Plugins, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        recognize(tmp_path, toys)
    assert "toy_scene" not in caught.value.what


def test_facts() -> None:
    scene = tiny_scene()
    lens = replace(scene.test[0].camera, fx=50.0, cx=17.0)
    scene = replace(scene, test=(replace(scene.test[0], camera=lens),))
    found = dict(facts(scene))
    size = scene.train[0].camera
    assert found["train"] == "2 views: view0, view2"
    assert found["test"] == "1 view: view1"
    assert found["size"] == f"{size.width}x{size.height}"
    assert found["focal x"] == f"{size.fx:.1f} .. 50.0 px"
    assert found["center off"] == "x 0.0 .. 1.0 px, y 0.0 px"
    assert found["depth"] == "1.5 .. 5"
    assert found["points"].startswith("60; ")
    assert found["true depth"] == "3 of 3 views"


def test_many_views_are_not_all_named() -> None:
    scene = tiny_scene()
    many = [replace(scene.train[0], name=f"view{k}") for k in range(25)]
    found = dict(facts(replace(scene, train=(*many,))))
    assert found["train"] == "25 views: view0, ..., view24"


def test_the_contact_sheet_frames_the_split_in_two_colours() -> None:
    scene = tiny_scene()
    pixels = (scene_picture(scene) * 255).round().to(torch.uint8).numpy()
    cell = (WIDTH - 8) // 5
    frames = [tuple(pixels[30, 8 + k * cell]) for k in range(3)]
    assert frames == [TRAIN_COLOR, TRAIN_COLOR, TEST_COLOR]
    image = pixels[40:80, 20:60].reshape(-1, 3)
    assert (image != 255).any()  # the photograph itself
    assert not np.array_equal(image, np.broadcast_to(TRAIN_COLOR, image.shape))


def test_the_plan_is_seen_from_above() -> None:
    scene = scene_of(camera(-1), camera(1), points=wall(50))
    plan = make_plan(scene, (400, 300))
    np.testing.assert_allclose(plan.right, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(plan.forward, [0, 0, 1], atol=1e-12)
    left, right, ahead = plan.pixels(
        plan.coordinates(np.array([[-1.0, 5, 0], [1, -5, 0], [0, 0, 2]]))
    )
    assert left[0] < ahead[0] < right[0]
    assert left[1] == pytest.approx(right[1])
    assert ahead[1] < left[1]
    for pixel in (left, right, ahead):
        assert (pixel >= 40).all()
        assert (pixel <= [360, 260]).all()


def test_cameras_and_points_are_drawn_where_the_plan_says() -> None:
    scene = scene_of(camera(-1), camera(1), points=wall(50))
    picture = (scene_picture(scene) * 255).round().to(torch.uint8).numpy()
    height = 640
    plan = make_plan(scene, (WIDTH, height))
    drawing = picture[-height:]
    positions = np.array([[-1.0, 0, 0], [1, 0, 0]])
    for column, row in plan.pixels(plan.coordinates(positions)).astype(int):
        spot = drawing[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3)
        assert (spot == TRAIN_COLOR).all(axis=1).any()
    ((column, row),) = plan.pixels(plan.coordinates(np.array([[0.1, 0, 2]]))).astype(int)
    assert (drawing[row - 1 : row + 2, column - 1 : column + 2] == 102).all(axis=2).any()


@pytest.mark.parametrize("rotation", ["down", "ring", "one place"])
def test_odd_scenes_can_be_drawn(rotation: str) -> None:
    cameras = [camera(0, 0), camera(0.5, 180)]
    if rotation == "down":  # all look along -up
        pose = torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 3], [0, 0, 0, 1]])
        cameras = [Camera(pose, 40, 40, 16, 12, 32, 24)] * 2
    if rotation == "one place":
        cameras = [camera()]
    picture = scene_picture(scene_of(*cameras))
    assert torch.isfinite(picture).all()


def test_far_points_do_not_shrink_the_cameras() -> None:
    cameras = [camera(x) for x in (-1.0, 0.0, 1.0)]
    near, far = wall(100, depth=3.0).positions, wall(60, depth=500.0).positions
    points = PointCloud(torch.cat([near, far]), torch.zeros(160, 3))
    plan = make_plan(scene_of(*cameras, points=points), (400, 300))
    centers = np.stack([c.center.numpy() for c in cameras])
    across = plan.pixels(plan.coordinates(centers))[:, 0]
    assert np.ptp(across) > 400 / 5
    inside = plan.pixels(plan.coordinates(near.double().numpy()))
    assert ((inside >= 0) & (inside <= [400, 300])).all()


def test_the_image_is_written_into_a_given_folder(install: Install, tmp_path: Path) -> None:
    install("toys", "1.5", TOY_ENTRIES)
    pipeline, folder = tmp_path / "toy.yaml", tmp_path / "pictures"
    pipeline.write_text("name: toy\nscene: toy_scene\ninitializer: toy_points\n")
    folder.mkdir()
    assert main(["check", str(pipeline), "--out", str(folder)]) == 0
    assert (folder / "check.png").is_file()


def test_options_of_photographs_are_settings_of_the_scene() -> None:
    changes = ["scene.train_views=3", "scene.test_every=4", "scene.require_all_photos=true"]
    given = ["--set", changes[0], "--test-every", "4", "--require-all-photos"]
    for verb in ("train", "check"):
        assert parse_command([verb, "folder", *given]).set == changes
        assert parse_command([verb, "folder"]).set == []
    with pytest.raises(ExplainedError, match="'often' is not a whole number, 0 or more"):
        parse_command(["train", "folder", "--test-every", "often"])
