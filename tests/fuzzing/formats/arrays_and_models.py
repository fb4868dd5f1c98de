"""Binary files of tensors: checkpoints, cached estimates of priors, ONNX models."""

from __future__ import annotations

import logging
import os
from unittest import mock

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from core_rasterizer import ExplainedError
from registry.toolkit.networks import OnnxModel
from tests.fuzzing.target import Target
from tests.host import Checkpoint, load_checkpoint, load_estimate, save_checkpoint, save_estimate

TENSORS = {"model/means": torch.arange(12.0).reshape(4, 3), "order": torch.arange(5)}


class Checkpoints(Target):
    """A checkpoint. It contains hashes, so all damage must be detected."""

    name = "checkpoints"

    def write(self) -> tuple[str, ...]:
        """Write one checkpoint."""
        save_checkpoint(Checkpoint(7, 1.5, TENSORS, "name: fuzzed\n"), self.folder)
        files = sorted(path for path in self.folder.rglob("*") if path.is_file())
        return tuple(str(path.relative_to(self.folder)) for path in files)

    def read(self) -> None:
        """Load it and compare it with the saved one."""
        found = load_checkpoint(self.folder)
        assert (found.iteration, found.seconds) == (7, 1.5)
        assert found.tensors.keys() == TENSORS.keys()
        assert all(torch.equal(found.tensors[name], TENSORS[name]) for name in TENSORS)


class Refused(ExplainedError):
    """A cached estimate was discarded."""


class PriorAnswers(Target):
    """A cached estimate: loading returns the saved one or None."""

    name = "cached answers"
    _key = "0123456789abcdef" * 2

    def write(self) -> tuple[str, ...]:
        """Write one estimate with an image and its inputs."""
        logging.getLogger("registry.toolkit.cache.entries").setLevel(logging.ERROR)
        with mock.patch.dict(os.environ, STEREOGS_CACHE=str(self.folder)):
            save_estimate(
                "fuzzed",
                self._key,
                TENSORS,
                {"depth": torch.full((3, 4, 3), 0.5)},
                {"question": "something"},
            )
        entry = self.folder / "fuzzed" / self._key
        return tuple(str(path.relative_to(self.folder)) for path in sorted(entry.iterdir()))

    def read(self) -> None:
        """Load it."""
        with mock.patch.dict(os.environ, STEREOGS_CACHE=str(self.folder)):
            found = load_estimate("fuzzed", self._key)
        if found is None:
            raise Refused("it is discarded")
        assert all(torch.equal(found[name], TENSORS[name]) for name in TENSORS)

    def restore(self, file: str) -> None:
        """Write the whole entry again: loading removes a damaged one."""
        for name in self.files:
            path = self.folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(self.whole(name))


class OnnxFiles(Target):
    """A small model; an accepted one runs, or explains why not."""

    name = "onnx"

    def write(self) -> tuple[str, ...]:
        """Write a model with a convolution in a loop of two iterations."""
        (self.folder / "model.onnx").write_bytes(small_network().SerializeToString())
        return ("model.onnx",)

    def read(self) -> None:
        """Load and run it."""
        model = OnnxModel(self.folder / "model.onnx", provider="cpu")
        if [spec.name for spec in model.inputs] == ["x"]:
            with mock.patch("registry.toolkit.networks.onnx_model.TIME_LIMIT", 0.2):
                answers = model.run({"x": torch.ones(1, 1, 4, 4)})
            assert all(answer.dtype == torch.float32 for answer in answers.values())


def small_network() -> onnx.ModelProto:
    """y = conv(x) + x, twice in a loop."""
    body = helper.make_graph(
        [
            helper.make_node("Conv", ["inner", "w"], ["bent"], pads=[1, 1, 1, 1]),
            helper.make_node("Add", ["bent", "inner"], ["inner_out"]),
            helper.make_node("Identity", ["going"], ["going_out"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("round", TensorProto.INT64, []),
            helper.make_tensor_value_info("going", TensorProto.BOOL, []),
            helper.make_tensor_value_info("inner", TensorProto.FLOAT, [1, 1, 4, 4]),
        ],
        [
            helper.make_tensor_value_info("going_out", TensorProto.BOOL, []),
            helper.make_tensor_value_info("inner_out", TensorProto.FLOAT, [1, 1, 4, 4]),
        ],
    )
    weights = np.random.default_rng(0).standard_normal((1, 1, 3, 3)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("Loop", ["rounds", "", "x"], ["y"], body=body)],
        "network",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 1, 4, 4])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 1, 4, 4])],
        [
            numpy_helper.from_array(np.array(2, np.int64), "rounds"),
            numpy_helper.from_array(weights, "w"),
        ],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
