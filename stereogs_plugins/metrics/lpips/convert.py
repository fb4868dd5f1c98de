"""Convert torchvision's weights to the ONNX file that LPIPS reads.

    python -m stereogs_plugins.metrics.lpips.convert vgg vgg16-397923af.pth vgg16.onnx

Prints the metric's settings for a pipeline. The file contains the convolutions up to the fifth layer that
LPIPS compares: VGG16 (Simonyan & Zisserman 2015) up to ReLU 5_3, AlexNet (Krizhevsky 2014) up to ReLU 5.
Origin of the weights: docs/protocols.md.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from core_rasterizer import ExplainedError
from registry import PluginError
from registry.toolkit.networks import read_model_file

from .files import read_tensors

if TYPE_CHECKING:
    from onnx import NodeProto, TensorProto
    from torch import Tensor

    from .known_files import NetworkName

OPSET, IR_VERSION = 17, 8


class Layer(NamedTuple):
    """A convolution followed by a ReLU."""

    number: int
    """Index of the convolution in torchvision's `features`; its weights are `features.{number}.weight`."""
    channels: int
    """Number of output channels."""
    kernel: int = 3
    stride: int = 1
    padding: int = 1
    pooled: int = 0
    """Kernel size of a max pooling with stride 2 before the convolution; 0: no pooling."""
    compared: bool = True
    """If True, LPIPS compares the output of the ReLU."""


LAYERS: dict[NetworkName, tuple[Layer, ...]] = {
    "vgg": (
        Layer(0, 64, compared=False),
        Layer(2, 64),
        Layer(5, 128, pooled=2, compared=False),
        Layer(7, 128),
        Layer(10, 256, pooled=2, compared=False),
        Layer(12, 256, compared=False),
        Layer(14, 256),
        Layer(17, 512, pooled=2, compared=False),
        Layer(19, 512, compared=False),
        Layer(21, 512),
        Layer(24, 512, pooled=2, compared=False),
        Layer(26, 512, compared=False),
        Layer(28, 512),
    ),
    "alex": (
        Layer(0, 64, kernel=11, stride=4, padding=2),
        Layer(3, 192, kernel=5, padding=2, pooled=3),
        Layer(6, 384, pooled=3),
        Layer(8, 256),
        Layer(10, 256),
    ),
}


def backbone(network: NetworkName, weights: Mapping[str, Tensor], where: str) -> bytes:
    """Return an ONNX file with input `image` [1, 3, H, W] and outputs `features0` to `features4`.

    Args:
        network: the network of the weights.
        weights: torchvision's state dict; only keys that start with `features.` are used.
        where: origin of the weights, for messages.

    Raises:
        PluginError: a weight is missing, has another shape or is not finite; `onnx` is not installed.
    """
    try:
        from onnx import helper
    except ImportError as error:
        raise PluginError(
            "writing ONNX files requires the package onnx", fix="pip install onnx"
        ) from error
    nodes: list[NodeProto] = []
    constants: list[TensorProto] = []
    maps: list[tuple[str, int]] = []
    before, channels = "image", 3
    for layer in LAYERS[network]:
        after = f"features{len(maps)}" if layer.compared else f"relu{layer.number}"
        constants += _constants(layer, channels, weights, where)
        nodes += _nodes(layer, before, after)
        if layer.compared:
            maps.append((after, layer.channels))
        before, channels = after, layer.channels
    image, *outputs = (
        helper.make_tensor_value_info(name, 1, [1, size, f"height_{name}", f"width_{name}"])
        for name, size in [("image", 3), *maps]
    )
    graph = helper.make_graph(nodes, network, [image], outputs, constants)
    versions = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=versions, ir_version=IR_VERSION)
    return bytes(model.SerializeToString())


def _constants(
    layer: Layer, channels: int, weights: Mapping[str, Tensor], where: str
) -> Iterator[TensorProto]:
    import torch
    from onnx import numpy_helper

    kernel = (layer.channels, channels, layer.kernel, layer.kernel)
    for kind, shape in (("weight", kernel), ("bias", (layer.channels,))):
        name = f"features.{layer.number}.{kind}"
        values = weights.get(name)
        if values is None or tuple(values.shape) != shape or not torch.isfinite(values).all():
            found = "is missing" if values is None else f"has the shape {list(values.shape)}"
            raise PluginError(
                f"the weight {name} must be {list(shape)} finite numbers, and it {found}",
                where=where,
                fix="use the file of torchvision's weights for this network",
            )
        yield numpy_helper.from_array(values.float().numpy(), name)


def _nodes(layer: Layer, before: str, after: str) -> Iterator[NodeProto]:
    from onnx import helper

    if layer.pooled:
        name, sides = f"pooled{layer.number}", [layer.pooled] * 2
        yield helper.make_node("MaxPool", [before], [name], kernel_shape=sides, strides=[2, 2])
        before = name
    names = [f"features.{layer.number}.{kind}" for kind in ("weight", "bias")]
    yield helper.make_node(
        "Conv",
        [before, *names],
        [f"sum{layer.number}"],
        kernel_shape=[layer.kernel] * 2,
        strides=[layer.stride] * 2,
        pads=[layer.padding] * 4,
    )
    yield helper.make_node("Relu", [f"sum{layer.number}"], [after])


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert a file; return the exit status, 2 after a reported error."""
    parser = argparse.ArgumentParser(
        prog="python -m stereogs_plugins.metrics.lpips.convert",
        description="Convert torchvision's weights to the ONNX file that the metric lpips reads.",
    )
    parser.add_argument("network", choices=sorted(LAYERS), help="the network of the weights")
    parser.add_argument("weights", type=Path, help="weights file: .pth, .safetensors or .npz")
    parser.add_argument("out", type=Path, help="ONNX file to write")
    given = parser.parse_args(arguments)
    try:
        tensors = read_tensors(read_model_file(given.weights, None).content, given.weights)
        content = backbone(given.network, tensors, str(given.weights))
        given.out.write_bytes(content)
    except (ExplainedError, OSError) as error:
        print(f"lpips: {error}", file=sys.stderr)
        return 2
    digest = hashlib.sha256(content).hexdigest()
    print(f"- use: lpips\n  network: {given.network}\n  file: {given.out}\n  sha256: {digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
