"""Tests by the author of a plugin: the contract, and the purpose of the component."""

import hashlib
from pathlib import Path

import onnx
import pytest
import torch
from onnx import TensorProto, helper
from stereogs_onnx_prior import PlainDepth, PlainDepthSettings

from core_rasterizer import open_device
from stereogs import api
from stereogs.testing import check


@pytest.fixture
def network(tmp_path: Path) -> Path:
    """The mean of the three channels as inverse depth."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "H", "W"])
    depth = helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, 1, "H", "W"])
    axes = helper.make_tensor("axes", TensorProto.INT64, [1], [1])
    mean = helper.make_node("ReduceMean", ["image", "axes"], ["depth"], keepdims=1)
    graph = helper.make_graph([mean], "mean", [image], [depth], [axes])
    opset = helper.make_opsetid("", 18)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=9), tmp_path / "m.onnx")
    return tmp_path / "m.onnx"


def test_it_keeps_the_contract(network: Path) -> None:
    digest = hashlib.sha256(network.read_bytes()).hexdigest()
    check(PlainDepth, model=network, sha256=digest)


def test_brighter_is_nearer_at_the_size_of_the_image(network: Path) -> None:
    prior = PlainDepth(PlainDepthSettings(model=network), api.Context("p", 0, open_device()))
    image = torch.linspace(0, 1, 20)[None, :, None].expand(15, 20, 3)
    answer = prior.estimate(image)
    assert answer.shape == (15, 20)
    assert (answer.diff(dim=1) > 0).all()


def test_another_file_is_refused(network: Path) -> None:
    settings = PlainDepthSettings(model=network, sha256="0" * 64)
    with pytest.raises(api.PluginError, match="hash"):
        PlainDepth(settings, api.Context("p", 0, open_device()))
