"""Which photographs the demo takes: what a loader recognizes and has settings for."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereogs.verbs.demo import DATA, photographs
from tests.host import SELECTION, Plugins
from tests.registry.conftest import Install

LOADERS = """\
import registry


class Settings(registry.Settings):
    path: str
    few: int = 9


class Small(registry.SceneLoader[Settings]):

    @classmethod
    def recognizes(cls, folder):
        return (folder / "SMALL").is_file()

    @classmethod
    def demo_settings(cls, folder):
        return {"few": 3} if (folder / "quick").is_dir() else None

    def load(self):
        raise NotImplementedError


class Silent(Small):
    @classmethod
    def recognizes(cls, folder):
        return True

    demo_settings = registry.SceneLoader.demo_settings


@registry.hookimpl
def stereogs_register_scenes(register):
    register("silent", Silent)
    register("small", Small)
"""


def scene(folder: Path, *, quick: bool = True) -> None:
    (folder / "quick" if quick else folder).mkdir(parents=True)
    (folder / "SMALL").touch()


def test_without_the_variable_there_are_no_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DATA, raising=False)
    assert photographs(Plugins()) is None


def test_a_scene_folder_or_the_first_of_several(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entries = {"silent": "small_loaders", "small": "small_loaders"}
    install("loaders", "1.0", entries, small_loaders=LOADERS)
    data = tmp_path / "data"
    data.mkdir()
    monkeypatch.setenv(DATA, str(data))
    assert photographs(Plugins()) is None
    scene(data / "a_big_one", quick=False)
    assert photographs(Plugins()) is None
    scene(data / "leaves ${x}")
    found = {"use": "small", "path": "${STEREOGS_DATA}/leaves $${x}", "few": 3}
    assert photographs(Plugins()) == found
    scene(data / "fern")
    assert photographs(Plugins()) == {**found, "path": "${STEREOGS_DATA}/fern"}
    monkeypatch.setenv(DATA, str(data / "fern"))
    assert photographs(Plugins()) == {**found, "path": "${STEREOGS_DATA}"}


def test_forward_facing_captures_need_small_images(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SELECTION, "llff")
    monkeypatch.setenv(DATA, str(tmp_path))
    (tmp_path / "images_4").mkdir()
    (tmp_path / "poses_bounds.npy").touch()
    assert photographs(Plugins()) is None
    (tmp_path / "images_8").mkdir()
    found = photographs(Plugins())
    assert found == {"use": "llff", "path": "${STEREOGS_DATA}", "train_views": 3}
