"""Digests of inputs: each change is detected and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from registry import PointCloud, Scene, View
from registry.runs.origin import changed_inputs, input_digests, listed
from registry.testing import tiny_scene
from tests.host import Plugins, parse_pipeline

TEXT = "name: x\nscene: toy_scene\ninitializer: toy_points\n"


def with_view(change: Callable[[View], View]) -> Scene:
    scene = tiny_scene()
    return replace(scene, train=(change(scene.train[0]), scene.train[1]))


def brighter(view: View) -> View:
    image = view.image.clone()
    image[3, 4, 1] += 2**-20
    return replace(view, image=image)


def depth_of(view: View) -> torch.Tensor:
    assert view.depth is not None
    return view.depth


def some_points() -> PointCloud:
    points = tiny_scene().points
    assert points is not None
    return points


CHANGES: dict[str, tuple[Scene, tuple[str, ...]]] = {
    "nothing": (tiny_scene(), ()),
    "a bit of a pixel": (with_view(brighter), ("the photograph of view0",)),
    "a lens": (
        with_view(lambda v: replace(v, camera=replace(v.camera, cx=v.camera.cx + 1e-9))),
        ("the camera of view0",),
    ),
    "a mask": (
        with_view(lambda v: replace(v, mask=torch.ones(24, 32, dtype=torch.bool))),
        ("the mask of view0",),
    ),
    "an alpha": (
        with_view(lambda v: replace(v, alpha=torch.ones(24, 32))),
        ("the alpha of view0",),
    ),
    "the shape of a depth": (
        with_view(lambda v: replace(v, depth=depth_of(v).reshape(32, 24))),
        ("the depth of view0",),
    ),
    "the type of a depth": (
        with_view(lambda v: replace(v, depth=depth_of(v).view(torch.int32))),
        ("the depth of view0",),
    ),
    "no depth": (with_view(lambda v: replace(v, depth=None)), ("the depth of view0",)),
    "the bounds": (replace(tiny_scene(), bounds=(1.0, 6.0)), ("the depth bounds",)),
    "the background": (replace(tiny_scene(), background=(1.0, 1.0, 1.0)), ("the background",)),
    "the order": (
        replace(tiny_scene(), train=tiny_scene().train[::-1]),
        ("the order of the views",),
    ),
    "no points": (replace(tiny_scene(), points=None), ("the points",)),
    "one point": (
        replace(
            tiny_scene(),
            points=replace(some_points(), positions=some_points().positions.flip(0)),
        ),
        ("the points",),
    ),
    "no point at all": (
        replace(tiny_scene(), points=PointCloud(torch.zeros(0, 3), torch.zeros(0, 3))),
        ("the points",),
    ),
}


@pytest.mark.parametrize(("scene", "changed"), CHANGES.values(), ids=list(CHANGES))
def test_each_changed_input_is_named(toys: Plugins, scene: Scene, changed: tuple[str, ...]) -> None:
    pipeline = parse_pipeline(TEXT, toys)
    before, now = input_digests(tiny_scene(), pipeline), input_digests(scene, pipeline)
    assert changed_inputs(before, now) == changed


def test_model_files_are_compared_by_the_hashes_in_the_pipeline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS")
    text = "name: x\nscene: procedural\ninitializer: random\nmetrics: [{use: lpips, file: a.onnx, "
    digests = [
        input_digests(tiny_scene(), parse_pipeline(f"{text}sha256: {digit * 64}}}]\n", Plugins()))
        for digit in "ab"
    ]
    assert changed_inputs(*digests) == ("the file of metrics.lpips.sha256",)


def test_the_network_of_a_prior_is_compared_by_its_content(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It may be missing, as its answers are in the cache; a finished run does not need them."""
    monkeypatch.delenv("STEREOGS_PLUGINS")
    file = tmp_path / "a.onnx"
    text = "name: x\nscene: procedural\ninitializer: random\npriors: [{use: onnx_mono, model: MODEL}]\n"
    pipeline = parse_pipeline(text.replace("MODEL", str(file)), Plugins())
    missing = input_digests(tiny_scene(), pipeline)
    file.write_bytes(b"one")
    one = input_digests(tiny_scene(), pipeline)
    file.write_bytes(b"two")
    two = input_digests(tiny_scene(), pipeline)
    assert changed_inputs(one, two) == ("the content of priors.onnx_mono.model",)
    assert changed_inputs(one, missing) == changed_inputs(missing, two) == ()


def test_a_long_list_is_cut() -> None:
    assert listed(("a", "b")) == "a, b"
    assert listed(tuple("abcdefg")) == "a, b, c, d, e and 2 more"
