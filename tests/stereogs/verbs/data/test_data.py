"""Copies of the published data sets: verified, refused with the consequence, and built."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import stereogs
from stereogs.verbs.data.building import build
from stereogs.verbs.data.verification import CONSEQUENCES, data_sets, verify
from tests.data import data_folder
from tests.host import SELECTION, load_protocol, main, protocol_names
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff


@pytest.fixture(autouse=True)
def _installed_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION, raising=False)


def copy(name: str, folder: Path) -> Path:
    """Copy a data set whose files may be written."""
    return shutil.copytree(data_folder(name), folder / name, copy_function=shutil.copyfile)


def test_every_protocol_has_a_data_set(capsys: pytest.CaptureFixture[str]) -> None:
    known = [name for data_set in data_sets() for name in data_set.protocols]
    assert sorted(known) == sorted(protocol_names())
    for data_set in data_sets():
        assert {*data_set.known("any")} | {p for s in data_set.scenes.values() for p in s} <= {
            *CONSEQUENCES
        }
        for name in data_set.protocols[1:]:
            assert load_protocol(name).scenes == load_protocol(data_set.protocols[0]).scenes
    assert main(["data"]) == 0
    assert "poses_bounds.npy, images_8/" in capsys.readouterr().out


def test_a_published_copy_is_recognized(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "check", "llff-3", str(data_folder("llff_fern"))]) == 0
    printed = capsys.readouterr().out
    assert printed.count("as published") == 4
    assert "train        image001, image010, image019" in printed


def test_a_differing_copy_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = copy("llff_fern", tmp_path)
    rows = np.load(folder / "poses_bounds.npy")
    rows[0, 3] += 1e-6
    np.save(folder / "poses_bounds.npy", rows)
    (folder / "images_8" / "image019.png").rename(folder / "images_8" / "a.png")
    assert main(["data", "check", "llff-3", str(folder)]) == 1
    printed = capsys.readouterr().out
    for part in ("cameras", "names", "photographs"):
        assert f"{part:<12} differs\n  {CONSEQUENCES[part]}" in printed


def test_missing_files_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "horns").mkdir()
    assert main(["data", "check", "llff-6", str(tmp_path / "horns")]) == 1
    printed = capsys.readouterr().out
    assert "poses_bounds.npy missing" in printed
    assert "nerf_llff_data.zip" in printed


@pytest.mark.parametrize(
    ("protocol", "name", "same"),
    [
        ("dtu-3", "dtu_scan114", ["cameras", "sphere"]),
        ("blender-8", "blender_lego", ["cameras"]),
    ],
)
def test_photographs_that_were_made_smaller(protocol: str, name: str, same: list[str]) -> None:
    found = {part: state for part, state, _ in verify(protocol, data_folder(name))}
    assert "pixels instead of" in found.pop("size")
    assert [part for part, state in found.items() if state == "as published"] == same


@pytest.mark.parametrize(
    ("protocol", "folder", "what"),
    [("llff-4", "fern", "'llff-4'"), ("llff-3", "garden", "does not end in the name of a scene")],
)
def test_unknown_names_are_refused(
    protocol: str, folder: str, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["data", "check", protocol, folder]) == 2
    assert what in capsys.readouterr().err


def test_photographs_at_an_eighth_are_means(tmp_path: Path) -> None:
    folder = write_llff(tmp_path / "fern", World(count=9))
    (folder / "images_2").rename(folder / "images")
    rows = np.load(folder / "poses_bounds.npy")
    rows[:, [4, 9, 14]] /= 2  # the photographs are the full size
    np.save(folder / "poses_bounds.npy", rows)
    written = build("llff-3", folder, tmp_path / "built", "transforms")
    first = sorted((folder / "images").iterdir())[1]
    large = np.asarray(Image.open(first), float)
    height, width = (side // 8 for side in large.shape[:2])
    means = large[: 8 * height, : 8 * width].reshape(height, 8, width, 8, 3).mean(axis=(1, 3))
    small = np.asarray(Image.open(tmp_path / "built" / "images_8" / first.name), float)
    assert np.abs(small[:height, :width] - means).max() <= 0.5 + 1e-9
    assert tmp_path / "built" / "transforms" / "transforms.json" in written
    scene = stereogs.load_scene(tmp_path / "built" / "transforms")
    assert (len(scene.train), len(scene.test)) == (3, 2)
    np.testing.assert_allclose(scene.train[0].image * 255, small, atol=1e-3)


def test_only_into_a_new_folder(tmp_path: Path) -> None:
    folder = write_llff(tmp_path / "fern", World())
    with pytest.raises(stereogs.ExplainedError, match="the folder is not empty"):
        build("llff-3", folder, folder, "colmap")
