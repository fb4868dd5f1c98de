"""Untrusted graphs read no other file; their time and memory are limited."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from registry import PluginError
from registry.toolkit.networks import OnnxModel, onnx_session
from registry.toolkit.networks.onnx_model import answers_within
from tests.fuzzing.formats.arrays_and_models import small_network
from tests.registry.toolkit.networks.conftest import FLOAT, LONG, addition, saved


def test_weights_in_a_second_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    onnx.save(
        addition(), path, save_as_external_data=True, location="weights.bin", size_threshold=0
    )
    assert (tmp_path / "weights.bin").is_file()
    with pytest.raises(PluginError, match="second file") as caught:
        OnnxModel(path)
    assert "onnx.save(onnx.load(path)" in caught.value.fix
    onnx.save(onnx.load(path), tmp_path / "one.onnx")  # what the message advises
    assert OnnxModel(tmp_path / "one.onnx").input("x").shape == (None, 3)


def apart(tensor: TensorProto) -> None:
    """Refer to a file outside the model's folder for the tensor's values; write the value before the key."""
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.value, entry.key = "../secret", "location"


def in_a_branch(model: onnx.ModelProto) -> Any:
    """A tensor in the subgraph of a node."""
    constant = helper.make_node("Constant", [], ["c"], value=numpy_helper.from_array(np.ones(3)))
    branch = helper.make_graph(
        [constant], "branch", [], [helper.make_tensor_value_info("c", TensorProto.DOUBLE, [3])]
    )
    node = helper.make_node("If", ["x"], ["y"], then_branch=branch, else_branch=branch)
    model.graph.node.append(node)
    return model.graph.node[-1].attribute[0].g.node[0].attribute[0].t


def sparse(model: onnx.ModelProto) -> Any:
    """The values of a sparse tensor."""
    added = model.graph.sparse_initializer.add()
    added.values.CopyFrom(numpy_helper.from_array(np.ones(3, np.float32), "s"))
    return added.values


def in_a_function(model: onnx.ModelProto) -> Any:
    """A tensor in a local function of the model."""
    constant = helper.make_node("Constant", [], ["c"], value=numpy_helper.from_array(np.ones(3)))
    function = helper.make_function("own", "F", [], ["c"], [constant], [])
    model.functions.append(function)
    return model.functions[0].node[0].attribute[0].t


@pytest.mark.parametrize(
    "chosen", [lambda model: model.graph.initializer[0], in_a_branch, sparse, in_a_function]
)
def test_no_other_file_is_read(
    tmp_path: Path, chosen: Callable[[onnx.ModelProto], TensorProto]
) -> None:
    model = addition()
    apart(chosen(model))
    (tmp_path / "secret").write_bytes(bytes(4096))
    (tmp_path / "models").mkdir()
    with pytest.raises(PluginError, match="second file"):
        OnnxModel(saved(tmp_path / "models", model))


def test_an_endless_graph_is_stopped(tmp_path: Path) -> None:
    model = small_network()
    rounds = model.graph.initializer[0]
    rounds.CopyFrom(numpy_helper.from_array(np.array(1 << 62), "rounds"))
    network = OnnxModel(saved(tmp_path, model), provider="cpu")
    with answers_within(0.3), pytest.raises(PluginError, match=r"within 0\.3 s") as caught:
        network.run({"x": torch.ones(1, 1, 4, 4)})
    assert "endless loop" in caught.value.fix


def test_a_graph_without_inputs_is_refused(tmp_path: Path) -> None:
    constant = helper.make_node("Constant", [], ["y"], value=numpy_helper.from_array(np.ones(3)))
    output = helper.make_tensor_value_info("y", TensorProto.DOUBLE, [3])
    model = helper.make_model(helper.make_graph([constant], "g", [], [output]), ir_version=8)
    del model.opset_import[:]
    model.opset_import.append(helper.make_opsetid("", 17))
    with pytest.raises(PluginError, match="has no input"):
        OnnxModel(saved(tmp_path, model))


def test_no_thread_outlives_a_run(tmp_path: Path) -> None:
    network = OnnxModel(saved(tmp_path, small_network()), provider="cpu")
    before = threading.active_count()
    for _ in range(200):
        network.run({"x": torch.ones(1, 1, 4, 4)})
        assert threading.active_count() == before


@pytest.mark.parametrize("sizes", [[0], [2, 0, 3]])
def test_a_loop_without_an_iteration_count_is_refused(tmp_path: Path, sizes: list[int]) -> None:
    """onnxruntime would read the first element of an empty tensor and crash."""
    model = small_network()
    rounds = model.graph.initializer[0]
    rounds.CopyFrom(numpy_helper.from_array(np.zeros(sizes, np.int64), "rounds"))
    with pytest.raises(PluginError, match="decided by 'rounds', which has no elements"):
        OnnxModel(saved(tmp_path, model), provider="cpu")


def test_empty_tensors_outside_control_flow_are_accepted(tmp_path: Path) -> None:
    model = small_network()
    model.graph.initializer.append(numpy_helper.from_array(np.zeros([0], np.float32), "unused"))
    OnnxModel(saved(tmp_path, model), provider="cpu").run({"x": torch.ones(1, 1, 4, 4)})


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Configure onnxruntime for a machine with 100 MB during a test."""
    monkeypatch.setattr(
        "registry.toolkit.networks.onnx_session.machine_memory", lambda: 100_000_000
    )
    onnx_session._bound_memory.cache_clear()
    yield
    onnx_session._bound_memory.cache_clear()


@pytest.mark.usefixtures("small_machine")
def test_the_memory_of_a_graph_is_limited(tmp_path: Path) -> None:
    """A file of 200 bytes that allocates any number of values."""
    graph = helper.make_graph(
        [helper.make_node("Expand", ["x", "count"], ["y"])],
        "large",
        [
            helper.make_tensor_value_info("x", FLOAT, [1]),
            helper.make_tensor_value_info("count", LONG, [1]),
        ],
        [helper.make_tensor_value_info("y", FLOAT, ["N"])],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    network = OnnxModel(saved(tmp_path, model), provider="cpu")
    x = torch.ones(1)
    assert len(network.run({"x": x, "count": torch.tensor([1e6])})["y"]) == 1_000_000
    with pytest.raises(PluginError, match="the model failed") as caught:
        network.run({"x": x, "count": torch.tensor([2**26])})
    assert "smaller ones if memory ran out" in caught.value.fix
