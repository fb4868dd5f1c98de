"""HITNet (Tankovich et al., CVPR 2021) from a frozen TensorFlow graph, node by node.

Only what this graph contains is converted. All integers become int64, as ONNX wants for shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .onnx_graph import OnnxGraph
from .tensorflow_file import FLOAT, Node, nodes

_GREY = np.array([0.299, 0.587, 0.114]) / 255
_LAST = np.iinfo(np.int64).max
_SAME_ARGUMENTS = {
    **{"Mul": "Mul", "Sub": "Sub", "AddV2": "Add", "BiasAdd": "Add", "Minimum": "Min"},
    **{"Maximum": "Max", "FloorDiv": "Div", "FloorMod": "Mod", "Abs": "Abs", "Floor": "Floor"},
    **{"GreaterEqual": "GreaterOrEqual", "Greater": "Greater", "Select": "Where"},
    **{"Reshape": "Reshape", "Shape": "Shape", "Range": "Range", "Tile": "Tile"},
}
"""Operators of TensorFlow that ONNX has under these names. Divided integers are never negative here."""


def convert(content: bytes) -> tuple[bytes, ...]:
    """Return a graph from `left`, `right` [N, 3, H, W] RGB 0..255 to `disparity` [N, 1, H, W] in pixels."""
    return (_Conversion().run(content),)


def _marked(mask: int, place: int) -> bool:
    return bool(mask >> place & 1)


class _Conversion:
    def __init__(self) -> None:
        self._graph = OnnxGraph("hitnet")
        self._names: dict[str, str] = {}
        self._arrays: dict[str, NDArray[Any]] = {}
        self._dilations: dict[str, list[int]] = {}

    def run(self, content: bytes) -> bytes:
        """Convert all nodes; the last one is the disparity."""
        graph, node = self._graph, None
        own: dict[str, Callable[[Node], str | list[str]]] = {
            name.removeprefix("_on_"): getattr(self, name)
            for name in dir(self)
            if name.startswith("_on_")
        }
        for node in nodes(content):
            if node.operator in _SAME_ARGUMENTS:
                values = graph(_SAME_ARGUMENTS[node.operator], *map(self._value, node.inputs))
            else:
                values = own[node.operator](node)
            for number, value in enumerate([values] if isinstance(values, str) else values):
                self._names[f"{node.name}:{number}"] = value
        assert node is not None
        disparity = graph("Transpose", self._value(node.name), perm=[0, 3, 1, 2])
        graph.output("disparity", disparity, ("batch", 1, "height", "width"))
        return graph.content()

    def _value(self, name: str) -> str:
        """The ONNX value of an output of a node; a constant is written when it is first used."""
        full = name if ":" in name else f"{name}:0"
        if full not in self._names:
            array = self._arrays[name]
            dtype = np.float32 if array.dtype == np.float32 else np.int64
            self._names[full] = self._graph.constant(array, dtype)
        return self._names[full]

    def _array(self, name: str) -> list[int]:
        return [int(number) for number in self._arrays[name].ravel()]

    def _integers(self, *numbers: int) -> str:
        return self._graph.constant(numbers, np.int64)

    def _on_Const(self, node: Node) -> list[str]:
        self._arrays[node.name] = node.tensor()
        return []

    def _on_Identity(self, node: Node) -> list[str]:
        (source,) = node.inputs
        if source in self._arrays:
            self._arrays[node.name] = self._arrays[source]
            return []
        return [self._value(source)]

    def _on_Placeholder(self, node: Node) -> str:
        """The grey pair in 0..1, channels last."""
        graph, greys = self._graph, []
        weights = graph.constant(_GREY.reshape(1, 3, 1, 1))
        for name in ("left", "right"):
            image = graph.input(name, ("batch", 3, "height", "width"))
            greys.append(graph("Conv", image, weights))
        pair = graph("Concat", *greys, axis=1)
        return str(graph("Transpose", pair, perm=[0, 2, 3, 1]))

    def _on_StridedSlice(self, node: Node) -> str:
        source, begin, _, strides = node.inputs
        begins, steps = self._array(begin), self._array(strides)
        dots = node.number("ellipsis_mask").bit_length()
        whole = node.number("ellipsis_mask") | (node.number("begin_mask") & node.number("end_mask"))
        places = [k for k in range(len(begins)) if not _marked(whole, k)]
        # What follows an ellipsis counts from the last dimension.
        axes = {k: k - len(begins) if dots and k >= dots else k for k in places}
        starts = [0 if _marked(node.number("begin_mask"), k) else begins[k] for k in places]
        value = self._graph(
            "Slice",
            *(self._value(source), self._integers(*starts), self._stops(node, places, begins)),
            *(self._integers(*axes.values()), self._integers(*(steps[k] for k in places))),
        )
        single = [axes[k] for k in places if _marked(node.number("shrink_axis_mask"), k)]
        return str(self._graph("Squeeze", value, self._integers(*single)) if single else value)

    def _stops(self, node: Node, places: list[int], begins: list[int]) -> str:
        """Ends of a slice; of a single place, the next one."""
        end = node.inputs[2]
        if end not in self._arrays:
            return str(self._graph("Gather", self._value(end), self._integers(*places)))
        stops = [
            _LAST if _marked(node.number("end_mask"), k) else self._array(end)[k] for k in places
        ]
        for index, k in enumerate(places):
            if _marked(node.number("shrink_axis_mask"), k):
                stops[index] = begins[k] + 1 or _LAST
        return self._integers(*stops)

    def _on_Pack(self, node: Node) -> str:
        axis = node.number("axis")
        parts = [
            self._graph("Unsqueeze", self._value(name), self._integers(axis))
            for name in node.inputs
        ]
        return str(self._graph("Concat", *parts, axis=axis))

    def _on_Unpack(self, node: Node) -> list[str]:
        source = self._value(node.inputs[0])
        numbers = [self._graph.constant(k, np.int64) for k in range(node.number("num"))]
        return [self._graph("Gather", source, k, axis=node.number("axis")) for k in numbers]

    def _on_ConcatV2(self, node: Node) -> str:
        *parts, axis = node.inputs
        return str(self._graph("Concat", *map(self._value, parts), axis=self._array(axis)[0]))

    def _on_Split(self, node: Node) -> list[str]:
        axis, source = node.inputs
        count = node.number("num_split")
        found: list[str] = self._graph(
            "Split", self._value(source), outputs=count, axis=self._array(axis)[0]
        )
        return found

    def _on_ExpandDims(self, node: Node) -> str:
        source, axis = node.inputs
        places = self._integers(*self._array(axis))
        return str(self._graph("Unsqueeze", self._value(source), places))

    def _on_Transpose(self, node: Node) -> str:
        source, order = node.inputs
        return str(self._graph("Transpose", self._value(source), perm=self._array(order)))

    def _on_Cast(self, node: Node) -> str:
        to = 1 if node.number("DstT") == FLOAT else 7  # FLOAT and INT64 in ONNX
        return str(self._graph("Cast", self._value(node.inputs[0]), to=to))

    def _on_LeakyRelu(self, node: Node) -> str:
        return str(self._graph("LeakyRelu", self._value(node.inputs[0]), alpha=node.real("alpha")))

    def _on_Sum(self, node: Node) -> str:
        source, axes = node.inputs
        places, kept = self._integers(*self._array(axes)), node.number("keep_dims")
        return str(self._graph("ReduceSum", self._value(source), places, keepdims=kept))

    def _on_ArgMin(self, node: Node) -> str:
        source, axis = node.inputs
        return str(
            self._graph("ArgMin", self._value(source), axis=self._array(axis)[0], keepdims=0)
        )

    def _on_ZerosLike(self, node: Node) -> str:
        value = self._value(node.inputs[0])
        return str(self._graph("Sub", value, value))

    def _on_Fill(self, node: Node) -> str:
        shape, value = map(self._value, node.inputs)
        return str(self._graph("Expand", value, shape))

    def _on_GatherV2(self, node: Node) -> str:
        """The axis is the first behind the batch dimensions, of which both inputs have the same."""
        source, places, _ = map(self._value, node.inputs)
        wanted = self._graph("Unsqueeze", places, self._integers(-1))
        return str(self._graph("GatherND", source, wanted, batch_dims=node.number("batch_dims")))

    def _on_Slice(self, node: Node) -> str:
        source, begin, size = map(self._value, node.inputs)
        return str(self._graph("Slice", source, begin, self._graph("Add", begin, size)))

    def _on_Pad(self, node: Node) -> str:
        source, sides, *value = map(self._value, node.inputs)
        flat = self._graph(
            "Reshape", self._graph("Transpose", sides, perm=[1, 0]), self._integers(-1)
        )
        return str(self._graph("Pad", source, flat, *value))

    _on_PadV2 = _on_Pad

    def _on_SpaceToBatchND(self, node: Node) -> str:
        """With `BatchToSpaceND` around a convolution: a dilated convolution."""
        source, block, _ = node.inputs
        self._dilations[node.name] = self._array(block)
        return self._value(source)

    def _on_BatchToSpaceND(self, node: Node) -> str:
        return self._value(node.inputs[0])

    def _on_Conv2D(self, node: Node) -> str:
        source, kernel = node.inputs
        weights = self._kernel(kernel, (3, 2, 0, 1))
        dilations = self._dilations.get(source)
        if dilations:  # the kernels are 3x3; onnxruntime pads dilated ones only explicitly
            padding: dict[str, Any] = {"pads": dilations * 2, "dilations": dilations}
        else:
            padding = {"auto_pad": "SAME_UPPER" if node.text("padding") == "SAME" else "VALID"}
        return self._convolution("Conv", node, source, weights, **padding)

    def _on_Conv2DBackpropInput(self, node: Node) -> str:
        """A transposed convolution, whose output is as many times larger as the stride says."""
        _, kernel, source = node.inputs
        sides = len(node.numbers("strides")) - 2
        weights = self._kernel(kernel, (sides + 1, sides, *range(sides)))
        return self._convolution("ConvTranspose", node, source, weights, auto_pad="SAME_UPPER")

    _on_Conv3DBackpropInputV2 = _on_Conv2DBackpropInput

    def _kernel(self, name: str, order: tuple[int, ...]) -> str:
        if name in self._arrays:
            return self._graph.constant(self._arrays[name].transpose(order))
        return str(self._graph("Transpose", self._value(name), perm=order))

    def _convolution(
        self, operator: str, node: Node, source: str, kernel: str, **attributes: Any
    ) -> str:
        """ONNX wants the channels first."""
        graph, strides = self._graph, node.numbers("strides")[1:-1]
        last = len(strides) + 1
        value = graph("Transpose", self._value(source), perm=[0, last, *range(1, last)])
        value = graph(operator, value, kernel, strides=strides, **attributes)
        return str(graph("Transpose", value, perm=[0, *range(2, last + 1), 1]))
