"""Models: inputs and outputs, type conversion, refusals, reproducibility."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from registry import PluginError
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from tests.registry.toolkit.networks.conftest import BYTE, FLOAT, HALF, LONG, addition, saved


def test_inputs_and_outputs_are_described(tmp_path: Path) -> None:
    model = OnnxModel(saved(tmp_path, addition(HALF, BYTE, LONG)))
    assert [(i.name, i.shape, i.dtype) for i in model.inputs] == [
        ("x", (None, 3), torch.float16),
        ("y", (3,), torch.uint8),
    ]
    assert str(model.outputs[0]) == "z int64[?, 3]"
    assert model.input("y") is model.inputs[1]
    assert model.output() is model.outputs[0]


def test_outputs_are_those_of_the_graph(path: Path) -> None:
    x, y = torch.tensor([[1.0, 2, 3], [4, 5, 6]]), torch.tensor([0.5, 0.25, -9])
    answer = OnnxModel(path).run({"x": x, "y": y})
    assert list(answer) == ["z"]
    assert answer["z"].dtype == torch.float32
    assert torch.equal(answer["z"], x + y + 1)


def test_the_first_run_logs_its_cost(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = OnnxModel(path, threads=3)
    with caplog.at_level(logging.INFO, "stereogs.priors"):
        for _ in range(2):
            model.run({"x": torch.zeros(2, 3), "y": torch.zeros(3)})
    (message,) = caplog.messages
    assert re.match(r"model\.onnx: \d+\.\d\d s on \w+, 3 threads, for x \[2, 3\], y \[3\]", message)
    assert message.endswith("MB so far")


def test_the_setting_selects_the_threads(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []
    session = onnxruntime.InferenceSession

    def watched(content: bytes, options: Any, **others: Any) -> Any:
        threads.append(options.intra_op_num_threads)
        return session(content, options, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", watched)
    assert OnnxModelSettings(model=path, threads=3).open().threads == 3
    assert threads == [3]
    assert OnnxModelSettings(model=path, threads=None).open().threads == threads[1] >= 1


@pytest.mark.parametrize("result", [FLOAT, HALF, LONG])
def test_types_are_converted_both_ways(tmp_path: Path, result: int) -> None:
    model = OnnxModel(saved(tmp_path, addition(BYTE, LONG, result)))
    x = torch.tensor([[-3.0, 99.6, 300.0]])  # clamped to 0, rounded to 100, clamped to 255
    answer = model.run({"x": x, "y": torch.tensor([-7.4, 0.0, 3.5])})["z"]
    assert answer.dtype == torch.float32
    assert answer.tolist() == [[-6.0, 101.0, 260.0]]  # 3.5 rounds to the even 4


def test_non_finite_values_are_accepted(path: Path) -> None:
    answer = OnnxModel(path).run({"x": torch.tensor([[torch.nan, 1, 2]]), "y": torch.zeros(3)})
    assert torch.isnan(answer["z"][0, 0])


def test_tensors_of_any_layout_are_accepted(path: Path) -> None:
    x = torch.arange(6.0).reshape(3, 2).T.requires_grad_()
    answer = OnnxModel(path).run({"x": x, "y": torch.zeros(3)})
    assert torch.equal(answer["z"], x.detach() + 1)


def test_unknown_names_are_refused_and_existing_ones_listed(path: Path) -> None:
    model = OnnxModel(path)
    with pytest.raises(PluginError, match="do not match the model") as caught:
        model.run({"x": torch.zeros(1, 3), "w": torch.zeros(3)})
    assert "['w']" in caught.value.what
    assert "['y']" in caught.value.what
    assert "x float32[?, 3], y float32[3]" in caught.value.fix
    with pytest.raises(PluginError, match="no output 'disp'"):
        model.output("disp")
    with pytest.raises(PluginError, match="2 inputs; its name must be specified"):
        model.input()


@pytest.mark.parametrize("shape", [(1, 4), (3,), (1, 3, 1)])
def test_other_shapes_are_refused(path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(PluginError, match="does not match the input 'x'") as caught:
        OnnxModel(path).run({"x": torch.zeros(shape), "y": torch.zeros(3)})
    assert "x float32[?, 3]" in caught.value.fix


def test_a_failure_inside_the_model_is_explained(tmp_path: Path) -> None:
    nodes = [helper.make_node("Add", ["x", "y"], ["z"])]
    sizes = {name: helper.make_tensor_value_info(name, FLOAT, [name]) for name in "xyz"}
    graph = helper.make_graph(nodes, "g", [sizes["x"], sizes["y"]], [sizes["z"]])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    with pytest.raises(PluginError, match="the model failed"):
        OnnxModel(saved(tmp_path, model)).run({"x": torch.zeros(3), "y": torch.zeros(4)})


def test_unsupported_types_are_refused(tmp_path: Path) -> None:
    nodes = [helper.make_node("Identity", ["x"], ["z"])]
    text = [helper.make_tensor_value_info(name, TensorProto.STRING, [1]) for name in "xz"]
    graph = helper.make_graph(nodes, "g", text[:1], text[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    with pytest.raises(PluginError, match=r"tensor\(string\)"):
        OnnxModel(saved(tmp_path, model))


def test_equal_inputs_give_equal_bits(tmp_path: Path) -> None:
    weights = np.random.default_rng(0).standard_normal((32, 8, 3, 3)).astype(np.float32)
    node = helper.make_node("Conv", ["x", "w"], ["z"], pads=[1, 1, 1, 1])
    graph = helper.make_graph(
        [node],
        "convolution",
        [helper.make_tensor_value_info("x", FLOAT, [1, 8, "H", "W"])],
        [helper.make_tensor_value_info("z", FLOAT, [1, 32, "H", "W"])],
        [numpy_helper.from_array(weights, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    path = saved(tmp_path, model)
    x = torch.rand(1, 8, 61, 47, generator=torch.Generator().manual_seed(1))
    answers = [OnnxModel(path).run({"x": x})["z"] for _ in range(3)]
    assert torch.equal(answers[0], answers[1])
    assert torch.equal(answers[0], answers[2])
    expected = torch.nn.functional.conv2d(x, torch.from_numpy(weights), padding=1)
    assert torch.allclose(answers[0], expected, atol=1e-4)
