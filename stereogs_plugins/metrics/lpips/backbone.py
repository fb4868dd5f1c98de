"""The network that LPIPS looks through, as an ONNX file made from torchvision's weights.

Only the convolutions up to the fifth layer that LPIPS compares are taken, so that neither torchvision nor
its other layers are needed: VGG16 (Simonyan & Zisserman 2015) up to ReLU 5_3, AlexNet (Krizhevsky 2014) up
to its fifth ReLU.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from registry import PluginError

if TYPE_CHECKING:
    from onnx import NodeProto, TensorProto
    from torch import Tensor

    from .known_files import NetworkName

OPSET, IR_VERSION = 17, 8


class Layer(NamedTuple):
    """A convolution and the ReLU behind it."""

    number: int
    """Of the convolution in torchvision's `features`, where its weights are `features.{number}.weight`."""
    channels: int
    """How many it answers."""
    kernel: int = 3
    stride: int = 1
    padding: int = 1
    pooled: int = 0
    """Side of the maximum that is taken, two pixels apart, before the convolution; 0: none is."""
    compared: bool = True
    """Whether LPIPS compares what the ReLU answers."""


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
    """The content of an ONNX file: `image` [1, 3, H, W] in, the five maps `features0` to `features4` out.

    Args:
        network: whose weights they are.
        weights: torchvision's state dict, or as much of it as begins with `features.`.
        where: where they come from, for messages.

    Raises:
        PluginError: a weight is missing, of another shape or not finite; `onnx` is not installed.
    """
    try:
        from onnx import helper
    except ImportError as error:
        raise PluginError(
            "writing ONNX files takes the package onnx", fix="pip install onnx"
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
                fix="name the file of torchvision's weights for this network",
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
