from __future__ import annotations

import errno

import pytest

from core_rasterizer import CameraError
from registry import PluginError, SceneError
from registry.calls.blame import blame
from tests.host import Item, Plugins, parse_pipeline

PIPELINE = "name: a\nscene: toy_scene\ninitializer: toy_points\nmetrics:\n  - psnr\n"


@pytest.fixture
def item(toys: Plugins) -> Item:
    return parse_pipeline(PIPELINE, toys, source="my.yaml").items["metrics"][0]


def test_any_exception_becomes_an_error_with_a_name(item: Item) -> None:
    with pytest.raises(PluginError) as caught, blame(item, 42):
        raise ZeroDivisionError("boom")
    error = caught.value
    assert "ZeroDivisionError: boom" in error.what
    assert error.where == "metric 'psnr' (unknown package ?) at my.yaml:5, iteration 42"
    assert "--disable psnr" in error.fix
    assert isinstance(error.__cause__, ZeroDivisionError)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 386. MiB"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes."),
        RuntimeError("std::bad_alloc"),
    ],
)
def test_memory_that_runs_out_is_no_fault_of_the_authors(item: Item, error: Exception) -> None:
    with pytest.raises(PluginError, match="memory ran out in") as caught, blame(item, 42):
        raise error
    assert caught.value.what.startswith("memory ran out in the metric 'psnr': ")
    assert caught.value.where.endswith("iteration 42")
    assert "end other programs" in caught.value.fix
    assert "authors" not in caught.value.fix


@pytest.mark.parametrize("kind", [SceneError, PluginError, CameraError])
def test_an_explained_error_keeps_what_it_says(item: Item, kind: type[SceneError]) -> None:
    with pytest.raises(kind) as caught, blame(item):
        raise kind("bad photograph", where="x.png", fix="take another")
    error = caught.value
    assert (error.what, error.fix) == ("bad photograph", "take another")
    assert error.where == "x.png; in metric 'psnr' (unknown package ?) at my.yaml:5"


def test_an_attempt_to_exit_is_a_failure_with_a_name(item: Item) -> None:
    with pytest.raises(PluginError, match="SystemExit: 3") as caught, blame(item):
        raise SystemExit(3)
    assert "my.yaml:5" in caught.value.where


def test_ctrl_c_passes_and_says_who_was_at_work(item: Item) -> None:
    with pytest.raises(KeyboardInterrupt) as caught, blame(item, 7):
        raise KeyboardInterrupt
    (note,) = caught.value.__notes__
    assert note == "while metric 'psnr' (unknown package ?) at my.yaml:5, iteration 7 was at work"


def test_an_error_without_a_fix_gets_one(item: Item) -> None:
    with pytest.raises(PluginError) as caught, blame(item):
        raise PluginError("no idea")
    assert caught.value.fix.endswith("switch it off with `--disable psnr`")


def test_what_a_pipeline_needs_is_not_to_be_switched_off(toys: Plugins) -> None:
    scene = parse_pipeline(PIPELINE, toys).one("scene")
    with pytest.raises(PluginError) as caught, blame(scene):
        raise ValueError
    assert "--disable" not in caught.value.fix
    assert "another scene loader" in caught.value.fix
