"""Training from a folder of each recognized format through the command line."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from stereogs import Pipeline
from tests.host import main
from tests.stereogs_plugins.scenes.test_formats import CASES

FORMATS: dict[str, Callable[[Path], Path]] = {
    name: lambda folder, write=write, world=world: write(folder, world)  # type: ignore[misc]
    for name, (_, write, world, _) in CASES.items()
}


def write_photos(folder: Path) -> Path:
    for index in range(3):
        Image.new("RGB", (40, 30), (60 * index, 0, 0)).save(folder / f"{index}.jpg")
    return folder


FORMATS["photos"] = write_photos


class Trained(BaseException):
    """Replacement for training."""


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[Pipeline]:
    """The pipelines that would be trained."""
    pipelines: list[Pipeline] = []

    def train(pipeline: Pipeline, *_: object, **__: object) -> None:
        pipelines.append(pipeline)
        raise Trained

    monkeypatch.setattr("stereogs.session.train", train)
    return pipelines


def scene_of(trained: list[Pipeline], *arguments: str) -> tuple[Pipeline, str, dict[str, Any]]:
    with pytest.raises(Trained):
        main(["train", *arguments])
    item = trained[-1].one("scene")
    return trained[-1], item.name, item.settings.model_dump()


@pytest.mark.parametrize("name", FORMATS)
def test_a_folder_is_trained(name: str, trained: list[Pipeline], tmp_path: Path) -> None:
    folder = tmp_path / "a ${b}: c"
    folder.mkdir()
    path = FORMATS[name](folder)
    pipeline, loader, settings = scene_of(trained, str(path))
    assert (pipeline.name, loader) == ("weightfree_fast", name)
    assert settings["path"] == path


def test_settings_of_another_loader_are_dropped(
    trained: list[Pipeline], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    (tmp_path / "photos").mkdir()
    path = f"scene.path={write_photos(tmp_path / 'photos')}"
    pipeline, loader, settings = scene_of(trained, "3dgs", "--set", path)
    assert (pipeline.name, loader, settings["train_views"]) == ("3dgs", "photos", None)
    assert "is read by the scene loader photos" in caplog.text
    change = ["--set", "scene.test_every=0", "--set", path]
    assert scene_of(trained, "3dgs", *change)[2]["test_every"] == 0


def test_the_loader_in_the_pipeline_keeps_its_settings(
    trained: list[Pipeline], tmp_path: Path
) -> None:
    path = f"scene.path={FORMATS['llff'](tmp_path)}"
    _, loader, settings = scene_of(trained, "3dgs", "--set", path)
    assert (loader, settings["train_views"]) == ("llff", 3)


def test_an_explicit_loader_is_used(trained: list[Pipeline], tmp_path: Path) -> None:
    path = f"scene={json.dumps({'use': 'colmap', 'path': str(write_photos(tmp_path))})}"
    assert scene_of(trained, "3dgs", "--set", path)[1] == "colmap"


def test_a_folder_of_no_known_format(
    trained: list[Pipeline], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").touch()
    assert main(["train", str(tmp_path)]) == 2
    assert "format is not known" in capsys.readouterr().err
    assert scene_of(trained, str(tmp_path), "--set", "scene.use=photos")[1] == "photos"


@pytest.mark.parametrize("name", ["photos.zip", "scene.ply", "transforms.json"])
def test_a_file_in_place_of_a_folder(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_photos(tmp_path)
    (tmp_path / name).touch()
    assert main(["train", str(tmp_path / name)]) == 2
    assert "give the folder that holds it" in capsys.readouterr().err


def test_an_unknown_pipeline(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "weightfre_fast"]) == 2
    assert "did you mean 'weightfree_fast'" in capsys.readouterr().err
