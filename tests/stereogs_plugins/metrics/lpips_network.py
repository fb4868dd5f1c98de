"""A network of LPIPS's structure with known weights: as ONNX, as TorchScript, and in plain numpy.

Five stages of a 2x2 convolution with stride 2 and ReLU, with as many channels as AlexNet's layers.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor

CHANNELS = (64, 192, 384, 256, 256)
Floats = NDArray[np.float64]


def weights(scale: float = 1.0) -> list[NDArray[np.float32]]:
    """`[C_out, C_in, 2, 2]` of each stage; the first stage's times `scale`."""
    generator = np.random.default_rng(4)
    sizes = zip(CHANNELS, (3, *CHANNELS[:-1]), strict=True)
    kernels = [
        (generator.standard_normal((after, before, 2, 2)) / np.sqrt(2 * before)).astype(np.float32)
        for after, before in sizes
    ]
    return [kernels[0] * np.float32(scale), *kernels[1:]]


def heads() -> list[NDArray[np.float32]]:
    """`[C]` of each stage, at least 0."""
    generator = np.random.default_rng(5)
    return [generator.random(channels).astype(np.float32) for channels in CHANNELS]


def features(image: Floats, scale: float) -> list[Floats]:
    """Of `[3, H, W]`, by numpy alone; H and W must be multiples of 32."""
    maps = []
    for kernel in weights(scale):
        channels, height, width = image.shape
        patches = image.reshape(channels, height // 2, 2, width // 2, 2)
        sums = np.tensordot(kernel.astype(np.float64), patches, axes=([1, 2, 3], [0, 2, 4]))
        image = np.maximum(sums, 0)
        maps.append(image)
    return maps


def distance(first: Floats, second: Floats, scale: float = 1.0) -> float:
    """LPIPS of two images `[H, W, 3]`, as the network's range wants them, by numpy alone."""
    shift, deviation = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    total = 0.0
    one, two = (
        features(np.moveaxis((image - shift) / deviation, -1, 0), scale)
        for image in (first, second)
    )
    for f, g, w in zip(one, two, heads(), strict=True):
        f, g = (x / (np.sqrt((x**2).sum(0)) + 1e-10) for x in (f, g))
        total += np.einsum("c,cyx->yx", w.astype(np.float64), (f - g) ** 2).mean()
    return float(total)


def onnx_features(path: Path, scale: float = 1.0) -> Path:
    """Write the network: one image in, five features out."""
    nodes, constants, before = [], [], "image"
    for stage, kernel in enumerate(weights(scale)):
        constants.append(numpy_helper.from_array(kernel, f"kernel{stage}"))
        nodes.append(
            helper.make_node(
                "Conv",
                [before, f"kernel{stage}"],
                [f"sum{stage}"],
                kernel_shape=[2, 2],
                strides=[2, 2],
            )
        )
        before = f"features{stage}"
        nodes.append(helper.make_node("Relu", [f"sum{stage}"], [before]))
    outputs = [
        helper.make_tensor_value_info(
            f"features{stage}", TensorProto.FLOAT, [1, channels, None, None]
        )
        for stage, channels in enumerate(CHANNELS)
    ]
    _save(path, nodes, ["image"], outputs, constants)
    return path


def onnx_difference(path: Path) -> Path:
    """Write a network that answers two images with their mean absolute difference."""
    nodes = [
        helper.make_node("Sub", ["first", "second"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["absolute"]),
        helper.make_node("ReduceMean", ["absolute"], ["distance"], keepdims=0),
    ]
    output = helper.make_tensor_value_info("distance", TensorProto.FLOAT, [])
    _save(path, nodes, ["first", "second"], [output], [])
    return path


def _save(
    path: Path,
    nodes: list[onnx.NodeProto],
    inputs: list[str],
    outputs: list[onnx.ValueInfoProto],
    constants: list[onnx.TensorProto],
) -> None:
    images = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, None, None])
        for name in inputs
    ]
    graph = helper.make_graph(nodes, "network", images, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    path.write_bytes(model.SerializeToString())


class Features(torch.nn.Module):
    """The network for TorchScript."""

    def __init__(self) -> None:
        super().__init__()
        self.stages = torch.nn.ModuleList()
        for kernel in weights():
            stage = torch.nn.Conv2d(kernel.shape[1], kernel.shape[0], 2, stride=2, bias=False)
            stage.weight = torch.nn.Parameter(torch.from_numpy(kernel))
            self.stages.append(stage)

    def forward(self, image: Tensor) -> list[Tensor]:
        maps = []
        for stage in self.stages:
            image = torch.relu(stage(image))
            maps.append(image)
        return maps


class Difference(torch.nn.Module):
    """The mean absolute difference of two images, for TorchScript."""

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        return (first - second).abs().mean()


def script(path: Path, module: torch.nn.Module) -> Path:
    """Write a module as TorchScript."""
    torch.jit.script(module).save(str(path))
    return path


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
