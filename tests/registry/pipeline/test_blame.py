from __future__ import annotations

import pytest

from core_rasterizer import CameraError
from registry import PluginError, SceneError
from registry.pipeline.blame import blame
from registry.pipeline.pipeline import Item, parse_pipeline
from registry.plugins import Plugins

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


@pytest.mark.parametrize("kind", [SceneError, PluginError, CameraError])
def test_an_explained_error_keeps_what_it_says(item: Item, kind: type[SceneError]) -> None:
    with pytest.raises(kind) as caught, blame(item):
        raise kind("bad photograph", where="x.png", fix="take another")
    error = caught.value
    assert (error.what, error.fix) == ("bad photograph", "take another")
    assert error.where == "x.png; in metric 'psnr' (unknown package ?) at my.yaml:5"


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_requests_to_stop_pass(item: Item, kind: type[BaseException]) -> None:
    with pytest.raises(kind), blame(item, 1):
        raise kind
