"""The protocols fit the scene loaders and metrics of this project, and real data."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from core_rasterizer import open_device
from registry import Scene
from tests.data import data_folder
from tests.host import Parts, Plugins, load_protocol, load_scene, parse_pipeline, protocol_names

TEXT = """\
name: under-protocol
protocol: {protocol}
scene: {{use: {loader}, path: "{path}"}}
initializer: random
"""


def under(protocol: str, loader: str, path: str) -> Scene:
    text = TEXT.format(protocol=protocol, loader=loader, path=path)
    return load_scene(Parts(parse_pipeline(text, Plugins()), open_device()).one("scene"))


@pytest.mark.parametrize("name", protocol_names())
def test_loaders_and_metrics_know_the_settings(name: str) -> None:
    for loader in load_protocol(name).loaders:
        text = TEXT.format(protocol=name, loader=loader, path="nowhere")
        pipeline = parse_pipeline(text, Plugins())
        assert pipeline.protocol is not None
        assert not pipeline.protocol.modified
        assert [item.name for item in pipeline.items["metrics"]] == [
            "psnr",
            "ssim",
            "ssim_skimage",
            "lpips",
        ]
        settings = pipeline.one("scene").settings.model_dump(mode="json")
        for key, value in load_protocol(name).loaders[loader].items():
            assert settings[key] == value


def test_llff() -> None:
    scene = under("llff-3", "llff", str(data_folder("llff_fern")))
    assert (len(scene.train), len(scene.test)) == (3, 3)
    assert [int(view.name[-3:]) for view in scene.test] == [0, 8, 16]
    assert scene.train[0].image.shape == (378, 504, 3)


def test_blender() -> None:
    scene = under("blender-8", "blender", str(data_folder("blender_lego")))
    assert (len(scene.train), len(scene.test)) == (8, 25)
    assert scene.background == (1.0, 1.0, 1.0)
    assert scene.train[0].image.shape == (400, 400, 3)


def test_dtu() -> None:
    scene = under("dtu-3", "dtu", str(data_folder("dtu_scan24")))
    assert (len(scene.train), len(scene.test)) == (3, 25)
    assert scene.test[0].image.shape == (300, 400, 3)
    assert all(view.mask is not None and 0 < view.mask.sum() < 120_000 for view in scene.test)


def test_the_pages_examples_are_pipelines() -> None:
    page = (Path(__file__).parents[2] / "docs" / "protocols.md").read_text("utf-8")
    modified, alex, lpips = re.findall(r"^```yaml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    rest = "name: example\ninitializer: random\n"
    scene = "scene: {use: llff, path: fern}\n"
    declared = parse_pipeline(rest + modified, Plugins()).protocol
    assert declared is not None
    assert declared.modified == {"scene.background": "black"}
    for example, network in ((alex, "alex"), (lpips, "vgg")):
        (metric,) = parse_pipeline(rest + scene + example, Plugins()).items["metrics"]
        assert metric.settings.model_dump()["network"] == network
