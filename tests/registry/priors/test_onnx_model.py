"""A model file is what its hash says, takes what its graph says, and answers float32."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from registry import OnnxModel, OnnxModelSettings, PluginError
from registry.priors import onnx_session
from tests.fuzzing.formats.arrays_and_models import small_network

FLOAT, HALF, BYTE, LONG = (
    TensorProto.FLOAT,
    TensorProto.FLOAT16,
    TensorProto.UINT8,
    TensorProto.INT64,
)


def addition(first: int = FLOAT, second: int = FLOAT, result: int = FLOAT) -> onnx.ModelProto:
    """z[N, 3] = x[N, 3] + y[3] + 1, with inputs and output of any type."""
    nodes = [
        helper.make_node("Cast", ["x"], ["x_float"], to=FLOAT),
        helper.make_node("Cast", ["y"], ["y_float"], to=FLOAT),
        helper.make_node("Add", ["x_float", "y_float"], ["sum"]),
        helper.make_node("Add", ["sum", "one"], ["more"]),
        helper.make_node("Cast", ["more"], ["z"], to=result),
    ]
    graph = helper.make_graph(
        nodes,
        "addition",
        [
            helper.make_tensor_value_info("x", first, ["N", 3]),
            helper.make_tensor_value_info("y", second, [3]),
        ],
        [helper.make_tensor_value_info("z", result, ["N", 3])],
        [numpy_helper.from_array(np.ones(1, np.float32), "one")],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)


def saved(folder: Path, model: onnx.ModelProto) -> Path:
    path = folder / "model.onnx"
    path.write_bytes(model.SerializeToString())
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return saved(tmp_path, addition())


def test_inputs_and_outputs_are_described(tmp_path: Path) -> None:
    model = OnnxModel(saved(tmp_path, addition(HALF, BYTE, LONG)))
    assert [(i.name, i.shape, i.dtype) for i in model.inputs] == [
        ("x", (None, 3), torch.float16),
        ("y", (3,), torch.uint8),
    ]
    assert str(model.outputs[0]) == "z int64[?, 3]"
    assert model.input("y") is model.inputs[1]
    assert model.output() is model.outputs[0]


def test_the_answer_is_that_of_the_graph(path: Path) -> None:
    x, y = torch.tensor([[1.0, 2, 3], [4, 5, 6]]), torch.tensor([0.5, 0.25, -9])
    answer = OnnxModel(path).run({"x": x, "y": y})
    assert list(answer) == ["z"]
    assert answer["z"].dtype == torch.float32
    assert torch.equal(answer["z"], x + y + 1)


def test_the_first_answer_tells_what_it_cost(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = OnnxModel(path, threads=3)
    with caplog.at_level(logging.INFO, "stereogs.priors"):
        for _ in range(2):
            model.run({"x": torch.zeros(2, 3), "y": torch.zeros(3)})
    (said,) = caplog.messages
    assert re.match(r"model\.onnx: \d+\.\d\d s on \w+, 3 threads, for x \[2, 3\], y \[3\]", said)
    assert said.endswith("MB so far")


def test_threads_are_those_of_the_setting(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    session = onnxruntime.InferenceSession

    def watched(content: bytes, options: Any, **others: Any) -> Any:
        asked.append(options.intra_op_num_threads)
        return session(content, options, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", watched)
    assert OnnxModelSettings(model=path, threads=3).open().threads == 3
    assert asked == [3]
    assert OnnxModelSettings(model=path).open().threads == asked[1] >= 1


@pytest.mark.parametrize("result", [FLOAT, HALF, LONG])
def test_types_are_converted_both_ways(tmp_path: Path, result: int) -> None:
    model = OnnxModel(saved(tmp_path, addition(BYTE, LONG, result)))
    x = torch.tensor([[-3.0, 99.6, 300.0]])  # clamped to 0, rounded to 100, clamped to 255
    answer = model.run({"x": x, "y": torch.tensor([-7.4, 0.0, 3.5])})["z"]
    assert answer.dtype == torch.float32
    assert answer.tolist() == [[-6.0, 101.0, 260.0]]  # 3.5 rounds to the even 4


def test_values_that_are_not_finite_pass(path: Path) -> None:
    answer = OnnxModel(path).run({"x": torch.tensor([[torch.nan, 1, 2]]), "y": torch.zeros(3)})
    assert torch.isnan(answer["z"][0, 0])


def test_tensors_of_any_layout_are_taken(path: Path) -> None:
    x = torch.arange(6.0).reshape(3, 2).T.requires_grad_()
    answer = OnnxModel(path).run({"x": x, "y": torch.zeros(3)})
    assert torch.equal(answer["z"], x.detach() + 1)


def test_the_hash_is_that_of_the_file_and_is_checked(path: Path) -> None:
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    model = OnnxModel(str(path), expected.upper())
    assert model.sha256 == expected
    assert expected in model.fingerprint
    assert model.provider in model.fingerprint
    with pytest.raises(PluginError) as caught:
        OnnxModel(path, "0" * 64)
    assert expected in caught.value.what
    assert "0" * 64 in caught.value.what
    assert caught.value.where == str(path)


def test_a_missing_file_says_how_to_name_one(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="cannot be read") as caught:
        OnnxModel(tmp_path / "none.onnx")
    assert "model:" in caught.value.fix
    assert "never downloaded" in caught.value.fix
    with pytest.raises(PluginError, match="cannot be read"):
        OnnxModel(tmp_path)


def test_what_has_no_end_is_no_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for path in (tmp_path / "pipe.onnx", Path("/dev/zero")):
        with pytest.raises(PluginError, match="it is no regular file"):
            OnnxModel(path)
    monkeypatch.setattr("registry.priors.model_file.LARGEST", 1000)
    large = tmp_path / "large.onnx"
    large.write_bytes(bytes(1001))
    with pytest.raises(PluginError, match="it has 1,001 bytes, more than 1,000"):
        OnnxModel(large)


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x08\x0a" * 40])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    with pytest.raises(PluginError, match="no ONNX model") as caught:
        OnnxModel(path)
    assert caught.value.where == str(path)


def test_no_name_of_a_file_reaches_the_terminal(
    path: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path.write_bytes(path.read_bytes().replace(b"\x22\x03Add", b"\x22\x03A\xf3\x1b"))
    with pytest.raises(PluginError, match="no ONNX model"):
        OnnxModel(path, provider="cpu")
    model = addition()
    model.graph.node[2].name = "\x1b[2J"
    network = OnnxModel(saved(tmp_path, model), provider="cpu")
    with pytest.raises(PluginError, match="the model failed"):
        network._answers({"x": np.zeros((2, 3), np.float32), "y": np.zeros(7, np.float32)})
    said = capfd.readouterr()
    assert said.out + said.err == ""


def test_a_truncated_file_is_refused(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(PluginError, match="no ONNX model"):
        OnnxModel(path)


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
    """Let a tensor's numbers lie in a file outside the model's folder; the value before the key."""
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.value, entry.key = "../secret", "location"


def in_a_branch(model: onnx.ModelProto) -> TensorProto:
    """A tensor of a graph within a node."""
    constant = helper.make_node("Constant", [], ["c"], value=numpy_helper.from_array(np.ones(3)))
    branch = helper.make_graph(
        [constant], "branch", [], [helper.make_tensor_value_info("c", TensorProto.DOUBLE, [3])]
    )
    node = helper.make_node("If", ["x"], ["y"], then_branch=branch, else_branch=branch)
    model.graph.node.append(node)
    return model.graph.node[-1].attribute[0].g.node[0].attribute[0].t


def sparse(model: onnx.ModelProto) -> TensorProto:
    """The values of a sparse tensor."""
    added = model.graph.sparse_initializer.add()
    added.values.CopyFrom(numpy_helper.from_array(np.ones(3, np.float32), "s"))
    return added.values


def in_a_function(model: onnx.ModelProto) -> TensorProto:
    """A tensor of a function of the model's own."""
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


def test_an_endless_graph_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = small_network()
    rounds = model.graph.initializer[0]
    rounds.CopyFrom(numpy_helper.from_array(np.array(1 << 62), "rounds"))
    monkeypatch.setattr("registry.priors.onnx_model.LONGEST_ANSWER", 0.3)
    network = OnnxModel(saved(tmp_path, model), provider="cpu")
    with pytest.raises(PluginError, match=r"no answer within 0\.3 s") as caught:
        network.run({"x": torch.ones(1, 1, 4, 4)})
    assert "loops without end" in caught.value.fix


def test_no_thread_outlives_an_answer(tmp_path: Path) -> None:
    network = OnnxModel(saved(tmp_path, small_network()), provider="cpu")
    before = threading.active_count()
    for _ in range(200):
        network.run({"x": torch.ones(1, 1, 4, 4)})
        assert threading.active_count() == before


@pytest.mark.parametrize("sizes", [[0], [2, 0, 3]])
def test_a_loop_without_a_number_of_rounds_is_refused(tmp_path: Path, sizes: list[int]) -> None:
    """onnxruntime would read the first of no elements, which ends the process."""
    model = small_network()
    rounds = model.graph.initializer[0]
    rounds.CopyFrom(numpy_helper.from_array(np.zeros(sizes, np.int64), "rounds"))
    with pytest.raises(PluginError, match="decided by 'rounds', which has no elements"):
        OnnxModel(saved(tmp_path, model), provider="cpu")


def test_empty_tensors_that_decide_nothing_are_fine(tmp_path: Path) -> None:
    model = small_network()
    model.graph.initializer.append(numpy_helper.from_array(np.zeros([0], np.float32), "unused"))
    OnnxModel(saved(tmp_path, model), provider="cpu").run({"x": torch.ones(1, 1, 4, 4)})


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine of 100 MB, as onnxruntime is told; afterwards it is told anew of this one."""
    monkeypatch.setattr("registry.priors.onnx_session.machine_memory", lambda: 100_000_000)
    onnx_session._bound_memory.cache_clear()
    yield
    onnx_session._bound_memory.cache_clear()


@pytest.mark.usefixtures("small_machine")
def test_a_graph_cannot_take_the_machines_memory(tmp_path: Path) -> None:
    """A file of 200 bytes that asks for as many numbers as it is told."""
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
    assert "smaller if memory ran out" in caught.value.fix


def test_other_names_are_refused_with_those_that_there_are(path: Path) -> None:
    model = OnnxModel(path)
    with pytest.raises(PluginError, match="other names") as caught:
        model.run({"x": torch.zeros(1, 3), "w": torch.zeros(3)})
    assert "['w']" in caught.value.what
    assert "['y']" in caught.value.what
    assert "x float32[?, 3], y float32[3]" in caught.value.fix
    with pytest.raises(PluginError, match="no output 'disp'"):
        model.output("disp")
    with pytest.raises(PluginError, match="2 inputs; which one is not said"):
        model.input()


@pytest.mark.parametrize("shape", [(1, 4), (3,), (1, 3, 1)])
def test_other_shapes_are_refused(path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(PluginError, match="'x' cannot have the shape") as caught:
        OnnxModel(path).run({"x": torch.zeros(shape), "y": torch.zeros(3)})
    assert "x float32[?, 3]" in caught.value.fix


def test_a_failure_inside_the_model_is_explained(tmp_path: Path) -> None:
    nodes = [helper.make_node("Add", ["x", "y"], ["z"])]
    sizes = {name: helper.make_tensor_value_info(name, FLOAT, [name]) for name in "xyz"}
    graph = helper.make_graph(nodes, "g", [sizes["x"], sizes["y"]], [sizes["z"]])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    with pytest.raises(PluginError, match="the model failed"):
        OnnxModel(saved(tmp_path, model)).run({"x": torch.zeros(3), "y": torch.zeros(4)})


def test_types_without_a_tensor_are_refused(tmp_path: Path) -> None:
    nodes = [helper.make_node("Identity", ["x"], ["z"])]
    text = [helper.make_tensor_value_info(name, TensorProto.STRING, [1]) for name in "xz"]
    graph = helper.make_graph(nodes, "g", text[:1], text[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    with pytest.raises(PluginError, match=r"tensor\(string\)"):
        OnnxModel(saved(tmp_path, model))


def test_the_processor_can_always_be_named(path: Path) -> None:
    assert OnnxModel(path, provider="cpu").provider == "cpu"


def test_a_provider_that_is_not_installed_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(PluginError, match="'cuda' here") as caught:
        OnnxModel(path, provider="cuda")
    assert "choose one of cpu" in caught.value.fix


@pytest.fixture
def without_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine whose onnxruntime was built for CUDA and finds no driver."""
    import onnxruntime

    start = onnxruntime.InferenceSession
    monkeypatch.setattr(
        "onnxruntime.get_available_providers",
        lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"],
    )
    monkeypatch.setattr(
        "onnxruntime.InferenceSession",
        lambda content, options, providers, **more: start(
            content, options, providers=["CPUExecutionProvider"], **more
        ),
    )


@pytest.mark.usefixtures("without_driver")
def test_falling_back_to_the_processor_is_not_silent(path: Path) -> None:
    with pytest.raises(PluginError, match="could not start 'cuda'"):
        OnnxModel(path, provider="cuda")
    assert OnnxModel(path).provider == "cpu"


class Lost:
    """The inside of a session whose provider is lost in its first answer."""

    def __init__(self, inside: Any) -> None:
        self._inside = inside
        self._answers = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inside, name)

    def set_providers(self, *arguments: object) -> None:
        self._answers = True

    def run(self, *arguments: Any) -> Any:
        from onnxruntime.capi.onnxruntime_pybind11_state import EPFail

        if self._answers:
            return self._inside.run(*arguments)
        raise EPFail("the device is gone")


@pytest.mark.usefixtures("without_driver")
def test_no_other_provider_goes_on(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = OnnxModel(path)
    monkeypatch.setattr(network._session, "_sess", Lost(network._session._sess))
    with pytest.raises(PluginError, match="the device is gone"):
        network.run({"x": torch.zeros(2, 3), "y": torch.zeros(3)})


def test_the_same_question_gets_the_same_bits(tmp_path: Path) -> None:
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
