"""A small ONNX graph, and a cache folder for results of priors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

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
    """Path of a file with the model `addition`."""
    return saved(tmp_path, addition())


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Cache folder of this test."""
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
