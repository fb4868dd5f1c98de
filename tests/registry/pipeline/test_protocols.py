"""A protocol fills in what it fixes, refuses what contradicts it, and is recorded whole."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import registry.pipeline.protocols as protocols
from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.pipeline.protocols import load_protocol, protocol_names
from tests.host import PipelineError, Plugins

NAMES = (
    *("blender-8", "blender-8-dietnerf", "dtu-3", "dtu-6", "dtu-9", "llff-3", "llff-6", "llff-9"),
    *("mipnerf360-12", "mipnerf360-24"),
)
TOY_PROTOCOL = """\
name: toy-1
title: Toys
scenes: [tiny, other]
train_views: 2
split: the first and the last train
scale: "1"
image_source: folder
filter: null
background: black
masks: null
loaders:
  toy_scene: {test_views: 1, colors: [1, 0.5, 0]}
metrics:
  - {use: psnr}
"""
TEXT = """\
name: small
protocol: toy-1
scene: toy_scene
initializer: toy_points
"""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, toys: Plugins) -> Plugins:
    """The toy components, and a folder of protocols with a toy in it."""
    (tmp_path / "toy-1.yaml").write_text(TOY_PROTOCOL)
    files = {"toy-1": (tmp_path / "toy-1.yaml",)}
    monkeypatch.setattr(protocols, "packaged_files", lambda group: files)
    return toys


def parse(plugins: Plugins, text: str = TEXT, *overrides: str, **more: Any) -> Pipeline:
    return parse_pipeline(text, plugins, source="a.yaml", overrides=overrides, **more)


def refused(plugins: Plugins, text: str = TEXT, *overrides: str, **more: Any) -> PipelineError:
    with pytest.raises(PipelineError) as caught:
        parse(plugins, text, *overrides, **more)
    assert caught.value.fix
    return caught.value


def test_the_protocols_that_there_are() -> None:
    assert protocol_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_each_file_holds_the_protocol_of_its_name(name: str) -> None:
    protocol = load_protocol(name)
    data_set, views, *_ = name.split("-")
    assert protocol.name == name
    assert protocol.train_views == int(views)
    expected = {"llff": 8, "dtu": 15, "mipnerf360": 7, "blender": 8}
    assert len(set(protocol.scenes)) == len(protocol.scenes) == expected[data_set]
    metrics = {rule["use"]: rule for rule in protocol.metrics}
    assert list(metrics) == ["psnr", "ssim", "ssim_skimage", "lpips"]
    assert all(rule["quantize"] == "png8" for rule in metrics.values())
    assert metrics["lpips"]["network"] == "vgg"


@pytest.mark.parametrize(
    ("name", "views"),
    [
        ("blender-8", [2, 16, 26, 55, 73, 76, 86, 93]),
        ("blender-8-dietnerf", [26, 86, 2, 55, 75, 93, 16, 73]),
    ],
)
def test_the_two_lists_of_blender_views(name: str, views: list[int]) -> None:
    protocol = load_protocol(name)
    assert protocol.loaders["blender"]["train_ids"] == views
    said = protocol.split.partition(";")[0]
    assert [int(number) for number in re.findall(r"\d+", said)] == views


@pytest.mark.parametrize("name", ["mipnerf360-12", "mipnerf360-24"])
def test_bounds_that_a_data_set_lacks_are_estimated(name: str) -> None:
    assert load_protocol(name).loaders["llff"]["bounds"] == "estimate"


def test_a_protocol_of_two_packages_is_refused(
    toy: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {"toy-1": (tmp_path / "toy-1.yaml", tmp_path / "other" / "toy-1.yaml")}
    monkeypatch.setattr(protocols, "packaged_files", lambda group: files)
    error = refused(toy)
    assert "'toy-1' is provided by several packages" in error.what
    assert error.where == "a.yaml:2"


def test_settings_and_metrics_are_filled_in(toy: Plugins) -> None:
    pipeline = parse(toy)
    settings = pipeline.one("scene").settings.model_dump()
    assert (settings["test_views"], settings["colors"]) == (1, (1.0, 0.5, 0.0))
    assert [item.name for item in pipeline.items["metrics"]] == ["psnr"]
    assert pipeline.protocol is not None
    assert pipeline.protocol.record()["modified"] == {}
    assert pipeline.protocol.record()["scenes"] == ["tiny", "other"]


def test_the_resolved_pipeline_names_its_protocol(toy: Plugins) -> None:
    pipeline = parse(toy)
    assert "protocol: toy-1\n" in pipeline.to_yaml()
    assert parse(toy, pipeline.to_yaml()) == pipeline


@pytest.mark.parametrize("override", ["protocol=null", "protocol="])
def test_without_a_protocol_nothing_is_filled_in(toy: Plugins, override: str) -> None:
    pipeline = parse(toy, TEXT, override)
    assert pipeline.protocol is None
    assert pipeline.items["metrics"] == ()
    assert "protocol" not in pipeline.to_yaml()


def test_what_agrees_may_be_written_and_other_settings_stay(toy: Plugins) -> None:
    pipeline = parse(toy, TEXT, "scene.test_views=1", "scene.path=x", "metrics=[psnr]")
    assert pipeline.one("scene").settings.model_dump()["path"] == Path("x")
    assert len(pipeline.items["metrics"]) == 1


def test_a_contradiction_names_both_places(toy: Plugins) -> None:
    error = refused(toy, TEXT.replace("scene: toy_scene", "scene: {use: toy_scene, test_views: 0}"))
    assert "scene.test_views is 0, but the protocol 'toy-1' fixes 1" in error.what
    assert error.where == "a.yaml:3 and protocols/toy-1.yaml:12"
    assert "modified: [scene.test_views]" in error.fix


def test_a_contradiction_can_be_declared(toy: Plugins) -> None:
    choice = "protocol={use: toy-1, modified: [scene.test_views, scene.colors]}"
    pipeline = parse(toy, TEXT, choice, "scene.test_views=0")
    assert pipeline.protocol is not None
    assert pipeline.protocol.record()["modified"] == {"scene.test_views": 0}
    assert pipeline.one("scene").settings.model_dump()["colors"] == (1.0, 0.5, 0.0)
    assert parse(toy, pipeline.to_yaml()) == pipeline


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("protocol=toy-2", "unknown protocol 'toy-2'; did you mean 'toy-1'"),
        ("protocol=3", "a protocol is a name, not 3"),
        ("protocol=[toy-1]", "a protocol is a name, not a list"),
        ("protocol={use: toy-1, modify: []}", "did you mean 'modified'"),
        ("protocol={modified: []}", "needs the setting 'use'"),
        (
            "protocol={use: toy-1, modified: [scene.test_view]}",
            "does not fix 'scene.test_view'; did you mean 'scene.test_views'",
        ),
        ("scene={path: x}", "does not cover the scene loader None"),
        ("scene.use=other", "does not cover the scene loader 'other'"),
        ("metrics=[{use: psnr, enabled: false}]", "measures 'psnr', which is disabled"),
        ("metrics=[{use: other, name: psnr}]", "metrics.psnr.use is 'other'"),
        ("metrics=psnr", "metrics must be a list"),
    ],
)
def test_mistakes_are_explained(toy: Plugins, override: str, message: str) -> None:
    assert message in refused(toy, TEXT, override).what


def test_a_metric_of_the_protocol_cannot_be_disabled(toy: Plugins) -> None:
    text = TEXT + "metrics: [psnr]\n"
    assert "which is disabled" in refused(toy, text, disabled=["psnr"]).what


def test_a_missing_scene_is_still_a_missing_scene(toy: Plugins) -> None:
    assert "has no scene loader" in refused(toy, TEXT.replace("scene: toy_scene\n", "")).what


def test_a_setting_that_a_loader_lacks_is_found_in_the_protocols_file(
    toy: Plugins, tmp_path: Path
) -> None:
    (tmp_path / "toy-1.yaml").write_text(TOY_PROTOCOL.replace("test_views: 1", "tests: 1"))
    error = refused(toy)
    assert "scene has no setting 'tests'" in error.what
    assert error.where == "protocols/toy-1.yaml:12"
