"""Which photographs the demo takes: the first forward-facing capture that has small images."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereogs.verbs.demo import DATA, photographs


def scene(folder: Path, images: str = "images_8") -> None:
    (folder / images).mkdir(parents=True)
    (folder / "poses_bounds.npy").touch()


def test_without_the_variable_there_are_no_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DATA, raising=False)
    assert photographs() is None


def test_a_scene_folder_or_the_first_of_several(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(DATA, str(tmp_path))
    assert photographs() is None
    scene(tmp_path / "a_big_one", "images_4")
    (tmp_path / "another" / "images_8").mkdir(parents=True)
    assert photographs() is None
    scene(tmp_path / "leaves ${x}")
    found = {"use": "llff", "path": "${STEREOGS_DATA}/leaves $${x}", "train_views": 3}
    assert photographs() == found
    scene(tmp_path / "fern")
    assert photographs() == {**found, "path": "${STEREOGS_DATA}/fern"}
    monkeypatch.setenv(DATA, str(tmp_path / "fern"))
    assert photographs() == {**found, "path": "${STEREOGS_DATA}"}
