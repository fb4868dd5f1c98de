"""MoGe-2, with graphs of its inputs and outputs that answer a known surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from registry import PluginError
from registry.testing import check
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.onnx_moge import OnnxMoge, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors.graphs import Graph

HEIGHT, WIDTH, FOCAL, SHIFT, SCALE = 30, 40, 50.0, 1.5, 2.5


def surface() -> tuple[Tensor, Tensor]:
    """Points `[H, W, 3]` of a bent surface as a pinhole camera sees them, and normals towards it."""
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    depth = 2 + 0.5 * torch.sin(u / 9) + 0.02 * v
    rays = torch.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, torch.ones_like(u)], 2)
    return rays * depth[..., None], -torch.nn.functional.normalize(rays, dim=2)


def moge(path: Path, points: Tensor, *, scale: bool = True, turned: bool = False) -> Path:
    """A graph that answers these points, with a mask that is the image's red channel."""
    graph = Graph()
    image = graph.input("image", ("B", 3, "H", "W"))
    tokens = graph.input("num_tokens", (), 7)
    zero = graph("Mul", tokens, graph.constant(0.0))
    shape = (1, *points.shape[:2])
    graph.output("points", graph("Add", graph.constant(points[None].numpy()), zero), (*shape, 3))
    normals = surface()[1] * (-1 if turned else 1)
    graph.output("normal", graph.constant(normals[None].numpy()), (*shape, 3))
    red = graph("Squeeze", graph.slice(image, 1, 0, 1), graph.constant([1], np.int64))
    graph.output("mask", red, ("B", "H", "W"))
    if scale:
        graph.output("metric_scale", graph.constant([SCALE]), (1,))
    return graph.save(path)


def of_any_size(path: Path) -> Path:
    """A graph for images of any size: depth is 1 plus the red channel, the shift 0."""
    graph = Graph()
    image = graph.input("image", ("B", 3, "H", "W"))
    graph.input("num_tokens", (), 7)
    red = graph("Squeeze", graph.slice(image, 1, 0, 1), graph.constant([1], np.int64))
    depth = graph("Add", red, graph.constant(1.0))
    ones = graph("Sub", depth, red)
    parts = []
    for axis in (2, 1):  # the running sum of ones counts pixels
        place = graph("CumSum", ones, graph.constant(axis, np.int64))
        count = graph("ReduceSum", ones, graph.constant([axis], np.int64))
        middle = graph("Mul", graph("Add", count, graph.constant(1.0)), graph.constant(0.5))
        offset = graph("Div", graph("Sub", place, middle), graph.constant(FOCAL))
        parts.append(graph("Mul", offset, depth))
    apart = [graph("Unsqueeze", part, graph.constant([3], np.int64)) for part in (*parts, depth)]
    graph.output("points", graph("Concat", *apart, axis=3), ("B", "H", "W", 3))
    return graph.save(path)


def image() -> Tensor:
    """White, with a black sky."""
    white = torch.ones(HEIGHT, WIDTH, 3)
    white[:5] = 0
    return white


def test_registers_as_onnx_moge() -> None:
    assert offered(stereogs_register_priors) == {"onnx_moge": OnnxMoge}


def test_it_keeps_the_contract(tmp_path: Path) -> None:
    path = of_any_size(tmp_path / "m.onnx")
    check(OnnxMoge, model=path)
    picture = torch.rand(24, 36, 3, generator=torch.Generator().manual_seed(0))
    found = build(OnnxMoge, model=path).depth(picture)
    assert torch.allclose(found.values, 1 + picture[..., 0], atol=1e-3)
    assert found.intrinsics is not None
    assert float(found.intrinsics[0, 0]) == pytest.approx(FOCAL, rel=1e-3)


@pytest.mark.parametrize("shift", [SHIFT, 2 * SHIFT, -SHIFT, 0.0])
def test_the_camera_and_the_shift_are_found(tmp_path: Path, shift: float) -> None:
    points, normals = surface()
    moved = points - torch.tensor([0.0, 0.0, shift])
    moved[:5] = torch.nan
    prior = build(OnnxMoge, model=moge(tmp_path / "m.onnx", moved))
    found = prior.depth(image())
    assert (found.ambiguity, found.inverse) == ("metric", False)
    assert found.valid is not None
    assert found.intrinsics is not None
    assert found.normals is not None
    assert found.valid.sum() == (HEIGHT - 5) * WIDTH
    assert not found.valid[:5].any()
    errors = (found.values - SCALE * points[..., 2])[5:]
    assert errors.abs().max() < 1e-3
    wanted = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    assert torch.allclose(found.intrinsics, wanted, atol=1e-2)
    assert torch.allclose(found.normals[5:], normals[5:], atol=1e-5)


def test_noise_moves_the_camera_little(tmp_path: Path) -> None:
    points, _ = surface()
    noise = 0.01 * torch.randn(points.shape, generator=torch.Generator().manual_seed(0))
    prior = build(OnnxMoge, model=moge(tmp_path / "m.onnx", points + noise))
    intrinsics = prior.depth(torch.ones(HEIGHT, WIDTH, 3)).intrinsics
    assert intrinsics is not None
    assert float(intrinsics[0, 0]) == pytest.approx(FOCAL, rel=0.1)


def test_without_a_scale_depth_has_one_unknown_factor(tmp_path: Path) -> None:
    path = moge(tmp_path / "m.onnx", surface()[0], scale=False, turned=True)
    found = build(OnnxMoge, model=path).depth(image())
    assert found.ambiguity == "scale"
    assert found.normals is not None
    assert (found.normals[5:, :, 2] < 0).all()


def test_what_no_camera_sees_is_refused(tmp_path: Path) -> None:
    path = moge(tmp_path / "m.onnx", surface()[0])
    prior = build(OnnxMoge, model=path)
    with pytest.raises(PluginError, match="fewer than three points"):
        prior.depth(torch.zeros(HEIGHT, WIDTH, 3))
    with pytest.raises(PluginError, match="'points' has the shape"):
        prior.depth(torch.ones(HEIGHT, WIDTH + 1, 3))
    mirrored = surface()[0] * torch.tensor([-1.0, -1.0, 1.0])
    prior = build(OnnxMoge, model=moge(tmp_path / "mirrored.onnx", mirrored))
    with pytest.raises(PluginError, match="no camera fits the points"):
        prior.depth(image())


def test_its_file_is_recognized(tmp_path: Path) -> None:
    path = moge(tmp_path / "m.onnx", surface()[0])
    (settings,) = OnnxMoge.settings_for(OnnxModel(path))
    assert settings["model"] == str(path)
