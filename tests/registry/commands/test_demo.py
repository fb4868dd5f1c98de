"""Which photographs the demo takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry.commands.demo import DATA, photographs


def scene(folder: Path, images: str = "images_8") -> None:
    (folder / images).mkdir(parents=True)
    (folder / "poses_bounds.npy").touch()


def test_without_the_variable_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DATA, raising=False)
    assert photographs() is None


def test_a_scene_of_its_own_or_one_of_several(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(DATA, str(tmp_path))
    assert photographs() is None
    scene(tmp_path / "big", images="images_4")
    assert photographs() is None
    scene(tmp_path / "leaves")
    assert photographs() == "${STEREOGS_DATA}/leaves"
    scene(tmp_path / "llff_fern")
    assert photographs() == "${STEREOGS_DATA}/llff_fern"
    monkeypatch.setenv(DATA, str(tmp_path / "leaves"))
    assert photographs() == "${STEREOGS_DATA}"
