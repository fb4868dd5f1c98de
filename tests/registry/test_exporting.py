"""Export of a finished run, with and without Gaussians of some kinds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

import stereogs
from registry import PluginError, RunError, Scene
from registry.testing import tiny_scene
from tests.host import PipelineError, main
from tests.registry.conftest import TOY_ENTRIES, Install

ITERATIONS = 8


@pytest.fixture(autouse=True)
def _toys(install: Install) -> None:
    install("toys", "1.5", TOY_ENTRIES)


def two_walls() -> Scene:
    """The tiny scene with points at z = 2 and z = 4, farther apart than the size of any Gaussian."""
    scene = tiny_scene()
    assert scene.points is not None
    positions = scene.points.positions.clone()
    positions[:, 2] = 2 + 2 * (torch.arange(len(positions)) % 3 == 0).float()
    return replace(scene, points=replace(scene.points, positions=positions))


def train(
    out: Path | None = None, *, kinds: bool = True, stop_at: int = ITERATIONS
) -> stereogs.Run:
    pipeline = {
        "name": "kinds",
        "initializer": {"use": "toy_points", "kinds": kinds},
        "densification": [{"use": "toy_growth", "every": 2}],
        "training": {"iterations": ITERATIONS, "sh_degree": 0, "fields": 2},
    }
    return stereogs.train(
        pipeline,
        scene=two_walls(),
        out=out,
        progress=False,
        callback=lambda done: done.number < stop_at,
    )


@cache
def trained() -> stereogs.Run:
    """Return a finished run in memory, which tests must not change."""
    return train()


def assert_kinds_are_correct(run: stereogs.Run) -> None:
    near = run.model.read("means")[:, 2] < 3
    assert sorted(run.kinds) == ["far", "near"]
    assert torch.equal(run.kinds["near"], near)
    assert torch.equal(run.kinds["far"], ~near)


def test_descendants_keep_their_kind(tmp_path: Path) -> None:
    """After clones, splits and prunings, in a checkpoint, and after resuming."""
    run = train(tmp_path / "run", stop_at=5)
    assert run.model.count != len(two_walls().points or ())
    assert_kinds_are_correct(run)
    assert_kinds_are_correct(stereogs.open_run(tmp_path / "run", scene=two_walls()))
    resumed = stereogs.resume(tmp_path / "run", scene=two_walls(), progress=False)
    assert_kinds_are_correct(resumed)
    assert resumed.hash == trained().hash


def test_kinds_do_not_change_the_gaussians(tmp_path: Path) -> None:
    without = train(kinds=False)
    assert without.hash == trained().hash
    assert without.kinds == {}
    with pytest.raises(RunError, match="no kind 'far'") as caught:
        stereogs.export(without, "toy_files", tmp_path, without=["far"])
    assert "does not distinguish kinds" in caught.value.fix


def test_a_kind_is_left_out_of_an_export(tmp_path: Path) -> None:
    run = trained()
    (whole,) = stereogs.export(run, "toy_files", tmp_path / "whole")
    (part,) = stereogs.export(run, "toy_files", tmp_path / "part", without=["far"])
    assert int(whole.read_text("utf-8")) == run.model.count
    assert int(part.read_text("utf-8")) == int(run.kinds["near"].sum()) < run.model.count


def test_export_errors_are_explained(tmp_path: Path) -> None:
    run, folder = trained(), tmp_path / "exports"
    with pytest.raises(RunError, match="no kind 'fat'; did you mean 'far'") as caught:
        stereogs.export(run, "toy_files", folder, without=["fat"])
    assert caught.value.fix == "kinds: near, far"
    with pytest.raises(RunError, match="all Gaussians would be left out"):
        stereogs.export(run, "toy_files", folder, without=["far", "near"])
    with pytest.raises(PluginError, match="no plugin offers the exporter 'toy_file'"):
        stereogs.export(run, "toy_file", folder)
    with pytest.raises(PipelineError, match="size"):
        stereogs.export(run, "toy_files", folder, changes=["size=3"])
    with pytest.raises(RunError, match="in memory only"):
        stereogs.export(run, "toy_files")
    assert not folder.exists()


def test_the_verb_writes_into_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipeline = {"scene": {"use": "toy_scene", "path": "x"}, "initializer": "toy_points"}
    training = {"name": "verb", "training": {"iterations": 1, "sh_degree": 0}}
    stereogs.train(pipeline | training, out=tmp_path / "run", progress=False)
    assert main(["export", str(tmp_path / "run"), "--format", "toy_files"]) == 0
    file = tmp_path / "run" / "exports" / "count.txt"
    assert capsys.readouterr().out == f"exported  {file}\n"
    assert file.read_text("utf-8") == "60"
